"""Decompression of chunks, up to a maximum size, and of incomplete ones as far as they go."""

from bz2 import BZ2Decompressor
from typing import BinaryIO, NamedTuple, Protocol

from lz4.frame import LZ4FrameDecompressor

__all__ = ["Allowance", "Unpacked", "check_chunk_size", "compression_of", "unpack", "unpack_lz4"]

PIECE = 1 << 18
MAX_AT_ONCE = 1 << 22
"""The libraries allocate this much before they know how much a piece unpacks to."""
MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}


class Unpacked(NamedTuple):
    """A decompressed chunk: `packed_size` bytes of the file were used; `complete` if they include end and checksum."""

    data: bytes
    packed_size: int
    complete: bool


class Allowance:
    """How much the chunks of a file may still unpack to.

    Args:
        size: Bytes of all chunks together.
    """

    def __init__(self, size: int) -> None:
        self._size = self._left = size

    def take(self, size: int) -> None:
        """Use up `size` bytes.

        Raises:
            ValueError: nothing is left.
        """
        if self._left < 0:
            raise ValueError(f"chunks unpack to more than {self._size} bytes, see limits.max_unpacked_file_gib")
        self._left -= size


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def compression_of(first_bytes: bytes) -> str:
    """The compression of data by their first bytes: `lz4`, `bz2`, or `none`."""
    return next((name for magic, name in MAGICS.items() if first_bytes.startswith(magic)), "none")


def check_chunk_size(size: int, largest: int) -> None:
    """Refuse a chunk that unpacks to `size` bytes.

    Raises:
        ValueError: this is more than `largest`.
    """
    if size > largest:
        raise ValueError(f"a chunk unpacks to more than {largest} bytes, see limits.max_chunk_mib")


def unpack_lz4(data: bytes, size: int, *, largest: int) -> bytes:
    """The content of a whole lz4 frame, nearly three times as fast as with `unpack`.

    Args:
        data: The frame.
        size: Its unpacked size according to the file: this much memory is allocated at once, and more if needed.
        largest: Bytes that it may unpack to.

    Raises:
        ValueError: it unpacks to more.
        EOFError: it ends early.
        RuntimeError: it is damaged.
    """
    decompressor = LZ4FrameDecompressor()
    parts: list[bytes] = [decompressor.decompress(data, min(size, largest) + 1)]
    total = len(parts[0])
    while not decompressor.eof:
        if decompressor.needs_input:
            raise EOFError("its lz4 data end early")
        check_chunk_size(total, largest)
        parts.append(decompressor.decompress(b"", MAX_AT_ONCE))
        total += len(parts[-1])
    check_chunk_size(total, largest)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpack(
    stream: BinaryIO, position: int, end: int, compression: str, *, largest: int, allowance: Allowance | None = None
) -> Unpacked:
    """The content of the compressed data that begin at `position` and end before `end`.

    Args:
        stream: The file.
        position: First byte of the data.
        end: Byte after the data.
        compression: `lz4` or `bz2`.
        largest: Bytes that they may unpack to.
        allowance: Bytes that all chunks together may unpack to.

    Raises:
        ValueError: they unpack to more.
        OSError: bz2 found damage.
        RuntimeError: lz4 found damage.
    """
    decompressor: _Decompressor = LZ4FrameDecompressor() if compression == "lz4" else BZ2Decompressor()
    stream.seek(position)
    parts: list[bytes] = []
    total = 0
    while not decompressor.eof:
        piece = b""
        if decompressor.needs_input:
            piece = stream.read(min(PIECE, end - stream.tell()))
            if not piece:
                break
        if allowance is not None:
            allowance.take(0 if not parts else len(parts[-1]))
        parts.append(decompressor.decompress(piece, MAX_AT_ONCE))
        total += len(parts[-1])
        check_chunk_size(total, largest)
    used = stream.tell() - position - len(decompressor.unused_data or b"")
    return Unpacked(b"".join(parts), used, decompressor.eof)
