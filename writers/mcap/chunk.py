"""A chunk of an MCAP file (mcap.dev/spec): messages put together without copying them, then compressed and written."""

import struct
import zlib
from collections.abc import Callable, Sequence
from typing import BinaryIO, Literal

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

Compression = Literal["none", "lz4", "zstd"]
Buffer = bytes | memoryview
Compress = Callable[[Sequence[Buffer]], Sequence[Buffer]]

LZ4_LEVEL = -2
"""Clouds and images shrink to 0.665 of their size; level 0 (0.647) and Zstandard take a quarter longer."""

VIEWED_BYTES = 1 << 12
"""Data from this size on are not copied: smaller ones would keep the memory that they are a part of."""

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII")
_SIZE = struct.Struct("<Q")


def compressor(compression: Compression) -> Compress:
    """The function that compresses a chunk's parts, or leaves them as they are; for one thread at a time."""
    if compression == "lz4":
        return lambda parts: [lz4.frame.compress(part, compression_level=LZ4_LEVEL) for part in parts]
    if compression == "zstd":
        zstd = zstandard.ZstdCompressor()
        return lambda parts: [*map(zstd.compress, parts)]
    return lambda parts: parts


class Chunk:
    """Records that wait to be written as one chunk.

    Attributes:
        size: Their bytes.
    """

    def __init__(self) -> None:
        self.size = 0
        self._parts: list[Buffer] = []
        self._messages: dict[int, list[int]] = {}
        """By channel, the log time and the place of each message, one after the other."""

    @property
    def has_messages(self) -> bool:
        """Whether it is worth writing."""
        return bool(self._messages)

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first log time, and the last one, which is not before 0."""
        times_ns = [places[::2] for places in self._messages.values()]
        return min(map(min, times_ns)), max(0, *map(max, times_ns))

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages by channel, in the order of their first ones."""
        return {channel: len(places) // 2 for channel, places in self._messages.items()}

    def add_record(self, record: bytes) -> None:
        """Add a schema or a channel."""
        self._parts.append(record)
        self.size += len(record)

    def add_message(self, channel: int, sequence: int, log_time_ns: int, data: Sequence[Buffer]) -> None:
        """Add a message, whose parts follow each other and must not change any more."""
        self._messages.setdefault(channel, []).extend((log_time_ns, self.size))
        parts = [part if len(part) >= VIEWED_BYTES else bytes(part) for part in data]
        length = _MESSAGE.size + sum(map(len, parts))
        head = _MESSAGE.pack(Opcode.MESSAGE, length - _RECORD.size, channel, sequence, log_time_ns, log_time_ns)
        self._parts += (head, *parts)
        self.size += length

    def write(self, stream: BinaryIO, compress: Compress, compression: Compression) -> ChunkIndex:
        """Write the chunk, and behind it where its messages lie.

        Returns:
            What the end of the file says of it.

        Raises:
            OSError: it cannot be written.
        """
        # Joined, they are summed at once, without the lock of the interpreter.
        parts = self._parts if compression == "none" else [b"".join(self._parts)]
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        data = compress(parts)
        size = sum(map(len, data))
        name = b"" if compression == "none" else compression.encode()
        start_ns, end_ns = self.span_ns
        start, length = stream.tell(), _CHUNK.size + len(name) + _SIZE.size + size
        about = length - _RECORD.size, start_ns, end_ns, self.size, crc, len(name)
        stream.write(b"".join((_CHUNK.pack(Opcode.CHUNK, *about), name, _SIZE.pack(size))))
        for piece in data:
            stream.write(piece)
        indexes, offsets, place = [], {}, start + length
        for channel, places in self._messages.items():
            offsets[channel] = place
            indexes.append(_message_index(channel, places))
            place += len(indexes[-1])
        stream.write(b"".join(indexes))
        return ChunkIndex(
            message_start_time=start_ns,
            message_end_time=end_ns,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=place - start - length,
            compression=name.decode(),
            compressed_size=size,
            uncompressed_size=self.size,
        )


def _message_index(channel: int, places: Sequence[int]) -> bytes:
    """A record with the log time and the place of each message, one after the other."""
    size = _SIZE.size * len(places)
    return struct.pack(f"<BQHI{len(places)}Q", Opcode.MESSAGE_INDEX, 6 + size, channel, size, *places)
