"""Whether a packet of H.264 is missing before another: decoders go on without it and show what they make up.

Source: ITU-T H.264, 7.3.2.1.1 (sequence parameter set), 7.3.3 (slice header), 7.4.3 (`frame_num`): it counts the
images that others refer to, so an image that nothing refers to may be missing unnoticed and harms nothing.
"""

import re

__all__ = ["GapFinder"]

_PARAMETERS = re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]")
_SLICE = re.compile(rb"\x00\x00\x01[\x01\x05\x21\x25\x41\x45\x61\x65]")
_IDR = 5
_ESCAPED = re.compile(rb"\x00\x00\x03")
_WITH_CHROMA_FORMAT = frozenset({100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135})
_LOOKED_AT = 64
"""Bytes of a unit that are read: what is sought lies in the first few."""


class GapFinder:
    """Follows the packets of one decoder, from one that it can begin with."""

    def __init__(self) -> None:
        self._digits: int | None = None
        self._reference = -1

    def gap_before(self, data: memoryview, *, is_key: bool) -> str:
        """Take the next packet; what is missing before it in words, empty where nothing is known to be."""
        if (parameters := _PARAMETERS.search(data)) is not None:
            self._digits = _frame_num_digits(_Bits(data, parameters.end()))
        piece = _SLICE.search(data)
        if piece is None or self._digits is None:
            return ""
        kind, is_reference = data[piece.end() - 1] & 31, bool(data[piece.end() - 1] >> 5)
        bits = _Bits(data, piece.end())
        bits.skip_codes(3)  # first_mb_in_slice, slice_type, pic_parameter_set_id
        number = 0 if kind == _IDR else bits.read(self._digits)
        before, self._reference = self._reference, number if is_reference or self._reference < 0 else self._reference
        following = (before + 1) % (1 << self._digits)
        if is_key or before < 0 or number in {before, following}:
            return ""
        return f"a packet before it is missing, or this one is broken: it has number {number}, expected {following}"


class _Bits:
    """Bits of a unit behind its first byte, without the bytes that only keep start codes apart; zeros at its end."""

    def __init__(self, data: memoryview, start: int) -> None:
        content = _ESCAPED.sub(b"\0\0", bytes(data[start : start + _LOOKED_AT]))
        self._value, self._left = int.from_bytes(content, "big"), 8 * len(content)

    def read(self, count: int) -> int:
        self._left -= count
        value = self._value >> self._left if self._left >= 0 else self._value << -self._left
        return value & ((1 << count) - 1)

    def code(self) -> int:
        """An unsigned Exp-Golomb code, 9.1."""
        zeros = 0
        while zeros < 32 and not self.read(1):
            zeros += 1
        return (1 << zeros) - 1 + self.read(zeros)

    def skip_codes(self, count: int) -> None:
        for _ in range(count):
            self.code()


def _frame_num_digits(bits: _Bits) -> int | None:
    """Bits of `frame_num`; None where the set allows gaps, or says what is not followed here."""
    profile = bits.read(8)
    bits.read(16)
    bits.skip_codes(1)  # seq_parameter_set_id
    if profile in _WITH_CHROMA_FORMAT:
        if bits.code() == 3:  # 4:4:4: may code the colours apart
            return None
        bits.skip_codes(2)  # bit depths
        if bits.read(2) & 1:  # scaling matrices
            return None
    digits = bits.code() + 4
    match bits.code():  # pic_order_cnt_type
        case 0:
            bits.skip_codes(1)
        case 1:
            return None
    bits.skip_codes(1)  # max_num_ref_frames
    allows_gaps = bits.read(1)
    return None if allows_gaps or digits > 16 else digits
