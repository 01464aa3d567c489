"""Decompression of chunks and messages, up to a maximum size, and of incomplete chunks as far as they go."""

from bz2 import BZ2Decompressor
from typing import BinaryIO, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.location import Location

PIECE_BYTES = 1 << 22
MAX_AT_ONCE = 1 << 22
"""The libraries allocate this much before they know how much a piece unpacks to."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}


class Unpacked(NamedTuple):
    """A decompressed chunk: `packed_size` bytes of the file were used; `complete` if they include end and checksum."""

    data: bytes
    packed_size: int
    complete: bool


def check_chunk_size(size: int, largest: int) -> None:
    """Refuse a chunk that unpacks to `size` bytes; raises ValueError if this is more than `largest`."""
    if size > largest:
        raise ValueError(f"a chunk unpacks to more than {largest} bytes, see limit_scale")


def check_file_size(path: Location, unpacked: int, packed: int, limits: RecordingLimits) -> None:
    """Refuse a file of `packed` bytes whose chunks unpack to too many in one reading, each as often as it is read."""
    largest = limits.max_unpacked_bytes(packed)
    if unpacked > largest:
        raise RecordingError(
            f"{path}: chunks of {packed} bytes unpack to more than {largest}, or overlap in time too often: "
            "rewrite it in the order of time, or raise limit_scale"
        )


def unpack(
    stream: BinaryIO,
    position: int,
    end: int,
    compression: str,
    *,
    largest: int,
    size: int | None = None,
    may_be_cut: bool = False,
) -> Unpacked:
    """The content of the lz4 or bz2 data that begin at `position` and end before `end`; at most `largest` bytes.

    `size` is their unpacked size according to the file: this much is allocated at once, and more if needed.
    """
    decompressor: LZ4FrameDecompressor | BZ2Decompressor = BZ2Decompressor()
    if compression == "lz4":
        decompressor = LZ4FrameDecompressor()
    stream.seek(position)
    parts: list[bytes] = []
    total, expected = 0, min(size or 0, largest)
    while not decompressor.eof:
        piece = b""
        if decompressor.needs_input:
            piece = stream.read(min(PIECE_BYTES, end - stream.tell()))
            if not piece:
                break
        at_once = expected - total + 1 if total <= expected and size else MAX_AT_ONCE
        parts.append(decompressor.decompress(piece, at_once))
        total += len(parts[-1])
        check_chunk_size(total, largest)
    if not (decompressor.eof or may_be_cut):
        raise EOFError(f"its {compression} data end early")
    used = stream.tell() - position - len(decompressor.unused_data or b"")
    return Unpacked(parts[0] if len(parts) == 1 else b"".join(parts), used, decompressor.eof)


def decompressed(data: bytes | memoryview, encoding: str, *, announced: bool, largest: int) -> bytes | memoryview:
    """The message, decompressed if rosbag2 compressed it by itself with zstd.

    metadata.yaml says whether it did, but is often lost. Zstd frames are recognised by their first bytes (RFC 8878,
    3.1.1), with which no CDR message can begin: its first byte is 0 (DDSI-RTPS 10.5).
    """
    if announced or (encoding == "cdr" and data[:4] == ZSTD_MAGIC):
        size = zstandard.frame_content_size(data)  # negative if the frame does not say it
        if size > largest:
            raise ValueError(f"a message unpacks to {size} bytes, see limit_scale")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=largest)
    return data
