"""Detects missing packets of H.264: decoders do not report them and show made-up images.

Source: ITU-T H.264, 7.3.2.1.1 (sequence parameter set), 7.3.3 (slice header), 7.4.3 (`frame_num`). `frame_num` counts
reference images only; a missing image that no other refers to goes unnoticed and does no harm.
"""

import re

_PARAMETERS = re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]")
_SLICE = re.compile(rb"\x00\x00\x01[\x01\x05\x21\x25\x41\x45\x61\x65]")
_IDR = 5
_ESCAPED = re.compile(rb"\x00\x00\x03")
_WITH_CHROMA_FORMAT = frozenset({100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135})
_HEAD_BYTES = 64
"""Bytes of a unit that are read; the fields are in the first few."""


class GapFinder:
    """Follows the packets of one decoder, starting with a key frame."""

    def __init__(self) -> None:
        self._digits: int | None = None
        self._reference = -1

    def gap_before(self, data: memoryview, *, is_key: bool) -> str:
        """Take the next packet; says what is missing before it, or is empty."""
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
    """Bits of a unit from `start` on, without emulation prevention bytes; zeros after its end."""

    def __init__(self, data: memoryview, start: int) -> None:
        content = _ESCAPED.sub(b"\0\0", bytes(data[start : start + _HEAD_BYTES]))
        self._value, self._left = int.from_bytes(content, "big"), 8 * len(content)

    def read(self, count: int) -> int:
        self._left -= count
        value = self._value >> self._left if self._left >= 0 else self._value << -self._left
        return value & ((1 << count) - 1)

    def code(self) -> int:
        """Read an unsigned Exp-Golomb code, 9.1."""
        zeros = 0
        while zeros < 32 and not self.read(1):
            zeros += 1
        return (1 << zeros) - 1 + self.read(zeros)

    def skip_codes(self, count: int) -> None:
        for _ in range(count):
            self.code()


def _frame_num_digits(bits: _Bits) -> int | None:
    """Length of `frame_num` in bits; None if the parameter set allows gaps or uses features not parsed here."""
    profile = bits.read(8)
    bits.read(16)
    bits.skip_codes(1)  # seq_parameter_set_id
    if profile in _WITH_CHROMA_FORMAT:
        if bits.code() == 3:  # 4:4:4: may code the colours separately
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
