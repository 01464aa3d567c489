"""Compressed chunks of bags, unpacked piece by piece: up to a size, and as far as a cut one goes."""

from bz2 import BZ2Decompressor
from typing import BinaryIO, NamedTuple, Protocol

from lz4.frame import LZ4FrameDecompressor

__all__ = ["LARGEST_CHUNK", "Unpacked", "compression_of", "unpack", "unpack_lz4"]

LARGEST_CHUNK = 1 << 28
"""Bytes that a chunk may unpack to: three hundred times what recorders write, and more than any one message."""

PIECE = 1 << 18
MOST_AT_ONCE = 1 << 22
"""The libraries take this much memory before they know how much a piece unpacks to."""
MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}


class Unpacked(NamedTuple):
    """What a chunk held: `packed_size` bytes of the file were used; `complete` if its own end and checksum came."""

    data: bytes
    packed_size: int
    complete: bool


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def compression_of(first_bytes: bytes) -> str:
    """The compression that data begin with: `lz4`, `bz2`, or `none`."""
    return next((name for magic, name in MAGICS.items() if first_bytes.startswith(magic)), "none")


def unpack_lz4(data: bytes, size: int) -> bytes:
    """A whole lz4 frame, in one piece: nearly three times as fast as `unpack`.

    Args:
        data: The frame.
        size: What it is said to unpack to: as much memory is taken at once, and more where it is not enough.

    Raises:
        ValueError: it is larger than `LARGEST_CHUNK`.
        EOFError: it ends early.
        RuntimeError: it is damaged.
    """
    decompressor = LZ4FrameDecompressor()
    parts: list[bytes] = [decompressor.decompress(data, min(size, LARGEST_CHUNK) + 1)]
    while not decompressor.eof:
        if decompressor.needs_input:
            raise EOFError("its lz4 data end early")
        _check_size(parts)
        parts.append(decompressor.decompress(b"", MOST_AT_ONCE))
    _check_size(parts)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _check_size(parts: list[bytes]) -> None:
    if sum(map(len, parts)) > LARGEST_CHUNK:
        raise ValueError(f"a chunk unpacks to more than {LARGEST_CHUNK} bytes")


def unpack(stream: BinaryIO, position: int, end: int, compression: str) -> Unpacked:
    """Unpack what begins at `position` and ends before `end`.

    Raises:
        ValueError: it is larger than `LARGEST_CHUNK`.
        OSError: bz2 found damage.
        RuntimeError: lz4 found damage.
    """
    decompressor: _Decompressor = LZ4FrameDecompressor() if compression == "lz4" else BZ2Decompressor()
    stream.seek(position)
    parts: list[bytes] = []
    while not decompressor.eof:
        piece = b""
        if decompressor.needs_input:
            piece = stream.read(min(PIECE, end - stream.tell()))
            if not piece:
                break
        parts.append(decompressor.decompress(piece, MOST_AT_ONCE))
        _check_size(parts)
    used = stream.tell() - position - len(decompressor.unused_data or b"")
    return Unpacked(b"".join(parts), used, decompressor.eof)
