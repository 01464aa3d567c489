"""What an MCAP file holds and where: from its summary section, or by a scan where that is missing or incomplete."""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import mcap.records as records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.stream_reader import get_chunk_data_stream

__all__ = ["ChunkPlace", "Contents", "Entry", "load_chunk", "messages_in", "read_contents", "read_exactly"]

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

MAGIC_BYTES = 8


class Entry(NamedTuple):
    """Where a message lies: sorts by time, then position; `chunk` is 0 outside of chunks."""

    log_time_ns: int
    chunk: int
    offset: int
    size: int
    channel_id: int


class ChunkPlace(NamedTuple):
    """A chunk before it is read; sorts among entries by the time of its first message."""

    start_ns: int
    position: int
    end_ns: int
    channel_ids: frozenset[int]
    """Channels in it; empty where the file does not say."""


@dataclass(slots=True)
class Contents:
    """What a file holds and where."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    chunks: list[ChunkPlace] = field(default_factory=list)
    loose: list[Entry] = field(default_factory=list)
    start_ns: int = 2**64
    end_ns: int = 0


def read_contents(reader: SeekingReader, stream: BinaryIO) -> Contents:
    """What the file says it holds; read once from end to end where it does not say all.

    Raises:
        ValueError: the summary and the file disagree.
        Exception: of the mcap library, where the file is damaged.
    """
    contents = _contents_of_summary(reader)
    if contents is None:
        contents = _contents_of_scan(stream)
        _check_against_summary(contents, reader)
    return contents


def _contents_of_summary(reader: SeekingReader) -> Contents | None:
    """What the summary section says; None where it leaves out something that is needed."""
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics = summary.statistics
    contents = Contents(
        schemas=summary.schemas,
        channels=summary.channels,
        counts=Counter(statistics.channel_message_counts),
        chunks=[
            ChunkPlace(
                chunk.message_start_time,
                chunk.chunk_start_offset,
                chunk.message_end_time,
                frozenset(chunk.message_index_offsets),
            )
            for chunk in summary.chunk_indexes
        ],
        start_ns=statistics.message_start_time,
        end_ns=statistics.message_end_time,
    )
    complete = (
        contents.counts.total() == statistics.message_count
        and len(contents.chunks) == statistics.chunk_count
        and (contents.chunks or not statistics.message_count)
        and contents.counts.keys() <= contents.channels.keys()
        and {channel.schema_id for channel in contents.channels.values()} <= {0, *contents.schemas}
    )
    return contents if complete else None


def _contents_of_scan(stream: BinaryIO) -> Contents:
    """The same by reading the whole file once, holding one chunk at a time."""
    contents = Contents()
    position = MAGIC_BYTES
    while True:
        stream.seek(position)
        opcode, length = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
        start = position + RECORD_HEAD.size
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return contents
        if opcode == Opcode.MESSAGE:
            head = read_exactly(stream, MESSAGE_HEAD.size)
            entry = _entry(head, 0, 0, start, length)
            contents.loose.append(entry)
            _count(contents, entry)
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            _register(contents, opcode, read_exactly(stream, length))
        elif opcode == Opcode.CHUNK:
            chunk = load_chunk(stream, position)
            times, ids = [], set()
            for inner, at, size in _records(chunk):
                if inner == Opcode.MESSAGE:
                    entry = _entry(chunk, at, position, at, size)
                    times.append(entry.log_time_ns)
                    ids.add(entry.channel_id)
                    _count(contents, entry)
                else:
                    _register(contents, inner, chunk[at : at + size])
            if times:
                contents.chunks.append(ChunkPlace(min(times), position, max(times), frozenset(ids)))
        position = start + length


def _check_against_summary(contents: Contents, reader: SeekingReader) -> None:
    """A record whose kind was overwritten would otherwise be skipped in silence."""
    unlisted = sum(count for id_, count in contents.counts.items() if id_ not in contents.channels)
    if unlisted:
        raise ValueError(f"{unlisted} messages of a channel that it does not list")
    summary = reader.get_summary()
    found = contents.counts.total()
    if summary and summary.statistics and summary.statistics.message_count != found:
        raise ValueError(f"its statistics say {summary.statistics.message_count} messages, found {found}")


def _count(contents: Contents, entry: Entry) -> None:
    contents.counts[entry.channel_id] += 1
    contents.start_ns = min(contents.start_ns, entry.log_time_ns)
    contents.end_ns = max(contents.end_ns, entry.log_time_ns)


def _register(contents: Contents, opcode: int, record: bytes) -> None:
    stream = ReadDataStream(BytesIO(record))
    if opcode == Opcode.SCHEMA:
        schema = records.Schema.read(stream)
        contents.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = records.Channel.read(stream)
        contents.channels[channel.id] = channel


def load_chunk(stream: BinaryIO, position: int) -> bytes:
    """The records of the chunk at `position`, decompressed, its checksum verified.

    Raises:
        ValueError: there is no chunk, its compression is unknown, or its size or checksum is wrong.
    """
    stream.seek(position)
    opcode, _ = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError(f"expected a chunk at byte {position}, found a record of kind {opcode}")
    chunk = records.Chunk.read(ReadDataStream(stream))
    if chunk.compression not in {"", "lz4", "zstd"}:
        raise ValueError(f"chunks compressed with {chunk.compression!r}, lidcam reads lz4 and zstd")
    unpacked, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise ValueError(f"chunk at byte {position}: expected {chunk.uncompressed_size} bytes, found {size}")
    return unpacked.read(size)


def _records(chunk: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and size of the content of each record in a chunk."""
    at = 0
    while at < len(chunk):
        opcode, size = RECORD_HEAD.unpack_from(chunk, at)
        at += RECORD_HEAD.size
        if at + size > len(chunk):
            raise ValueError(f"a record of {size} bytes reaches beyond its chunk of {len(chunk)}")
        yield opcode, at, size
        at += size


def messages_in(chunk: bytes, position: int) -> Iterator[Entry]:
    """The messages of the chunk at `position`, in the order in which they lie there."""
    for opcode, at, size in _records(chunk):
        if opcode == Opcode.MESSAGE:
            yield _entry(chunk, at, position, at, size)


def _entry(head: bytes, at: int, chunk_position: int, start: int, size: int) -> Entry:
    """The message whose record content starts at `start`; its first fields are in `head` at `at`."""
    channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(head, at)
    if size < MESSAGE_HEAD.size:
        raise ValueError(f"a message record of {size} bytes")
    return Entry(log_time_ns, chunk_position, start + MESSAGE_HEAD.size, size - MESSAGE_HEAD.size, channel_id)


def read_exactly(stream: BinaryIO, size: int) -> bytes:
    """The next `size` bytes.

    Raises:
        EOFError: the file ends before.
    """
    data = stream.read(size)
    if len(data) != size:
        raise EOFError(f"expected {size} more bytes, found {len(data)}")
    return data
