"""What an MCAP file holds and where: from its summary section, or by a scan where that is missing or incomplete."""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

import mcap.records as records
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader

from pipeline.core.errors import RecordingError
from pipeline.core.settings.recording import LimitsConfig
from readers.files.decompress import check_chunk_size, unpack, unpack_lz4
from readers.files.remote import tell_full_read

__all__ = [
    "ChunkHead",
    "ChunkPlace",
    "Contents",
    "Entry",
    "add_loose",
    "contents_of_summary",
    "count_entry",
    "entry_of",
    "has_sound_summary",
    "load_chunk",
    "messages_in",
    "read_chunk_head",
    "read_contents",
    "read_exactly",
    "records_in",
    "register",
]

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, size unpacked, crc, length of the compression's name
UINT64 = struct.Struct("<Q")
FOOTER = struct.Struct("<BQQQI")  # head, begin of the summary, begin of its offsets, crc of the summary

MAGIC_BYTES = 8
BLOCK = 1 << 20
MAX_NAME_BYTES = 32
END_OF_TIME_NS = 1 << 63
"""Times are 64 bits without sign in the file, and with one everywhere else."""


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
    size: int = 0
    """Bytes that it takes up in the file; 0 where that is not known."""


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
    cut_chunk: int | None = None
    """Position of the chunk inside which the file ends, if it was opened to be rescued."""


def read_contents(reader: SeekingReader, stream: BinaryIO, limits: LimitsConfig) -> Contents:
    """What the file says it holds; read once from end to end where it does not say all.

    Raises:
        ValueError: the summary and the file disagree.
        Exception: of the mcap library, where the file is damaged.
    """
    contents = contents_of_summary(reader, stream)
    if contents is None:
        tell_full_read(stream, "its summary does not say all that is in it")
        contents = _contents_of_scan(stream, limits)
        _check_against_summary(contents, reader)
    return contents


def has_sound_summary(stream: BinaryIO) -> bool:
    """Whether the summary section has the checksum that the footer names, or the footer names none.

    Raises:
        OSError: the file is shorter than a footer.
    """
    end = stream.seek(-FOOTER.size - MAGIC_BYTES, 2)
    _, _, start, _, crc = FOOTER.unpack(read_exactly(stream, FOOTER.size))
    if not crc or not start:
        return True
    if start > end:
        return False
    stream.seek(start)
    left = end + FOOTER.size - 4 - start  # all but the checksum itself
    found = 0
    while left > 0:
        block = read_exactly(stream, min(left, BLOCK))
        found = zlib.crc32(block, found)
        left -= len(block)
    return bool(found == crc)


def contents_of_summary(reader: SeekingReader, stream: BinaryIO) -> Contents | None:
    """What the summary section says; None where it leaves out something that is needed.

    Raises:
        ValueError: its checksum is wrong.
        Exception: of the mcap library, where it is damaged.
    """
    summary = reader.get_summary()
    if not has_sound_summary(stream):
        raise ValueError("the checksum of its summary is wrong")
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
                chunk.chunk_length,
            )
            for chunk in summary.chunk_indexes
        ],
        start_ns=statistics.message_start_time,
        end_ns=statistics.message_end_time,
    )
    if len({chunk.position for chunk in contents.chunks}) < len(contents.chunks):
        raise ValueError("its index names a chunk twice")
    if contents.start_ns >= END_OF_TIME_NS or contents.end_ns >= END_OF_TIME_NS:
        raise ValueError("its statistics name times that there are not")
    complete = (
        contents.counts.total() == statistics.message_count
        and len(contents.chunks) == statistics.chunk_count
        and (contents.chunks or not statistics.message_count)
        and contents.counts.keys() <= contents.channels.keys()
        and {channel.schema_id for channel in contents.channels.values()} <= {0, *contents.schemas}
    )
    return contents if complete else None


def add_loose(contents: Contents, entry: Entry, limits: LimitsConfig) -> None:
    """Take in a message outside of chunks.

    Raises:
        RecordingError: there are more of them than may be held in memory.
    """
    if len(contents.loose) >= limits.max_messages_in_memory:
        raise RecordingError(
            f"more than {limits.max_messages_in_memory} messages outside of chunks: write it anew with chunks, or "
            "raise limits.max_messages_in_memory"
        )
    contents.loose.append(entry)
    count_entry(contents, entry)


def _contents_of_scan(stream: BinaryIO, limits: LimitsConfig) -> Contents:
    """The same by reading the whole file once, holding one chunk at a time."""
    contents = Contents()
    position = MAGIC_BYTES
    while True:
        stream.seek(position)
        opcode, length = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
        start = position + RECORD_HEAD.size
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return contents
        if not opcode:  # no kind of record, also of none to come
            raise ValueError(f"no record begins at byte {position}")
        if opcode == Opcode.MESSAGE:
            head = read_exactly(stream, MESSAGE_HEAD.size)
            entry = entry_of(head, 0, 0, start, length)
            add_loose(contents, entry, limits)
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            register(contents, opcode, read_exactly(stream, length))
        elif opcode == Opcode.CHUNK:
            chunk = load_chunk(stream, position, limits)
            times, ids = [], set()
            for inner, at, size in records_in(chunk, limits):
                if inner == Opcode.MESSAGE:
                    entry = entry_of(chunk, at, position, at, size)
                    times.append(entry.log_time_ns)
                    ids.add(entry.channel_id)
                    count_entry(contents, entry)
                else:
                    register(contents, inner, chunk[at : at + size])
            if times:
                contents.chunks.append(
                    ChunkPlace(min(times), position, max(times), frozenset(ids), start + length - position)
                )
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


def count_entry(contents: Contents, entry: Entry) -> None:
    """Count a message and widen the time span."""
    contents.counts[entry.channel_id] += 1
    contents.start_ns = min(contents.start_ns, entry.log_time_ns)
    contents.end_ns = max(contents.end_ns, entry.log_time_ns)


def register(contents: Contents, opcode: int, record: bytes) -> None:
    """Take in a schema or channel record; others are passed over."""
    stream = ReadDataStream(BytesIO(record))
    if opcode == Opcode.SCHEMA:
        schema = records.Schema.read(stream)
        contents.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = records.Channel.read(stream)
        contents.channels[channel.id] = channel


def load_chunk(
    stream: BinaryIO,
    position: int,
    limits: LimitsConfig,
    *,
    before: int | None = None,
    is_cut: bool = False,
    verify: bool = True,
) -> bytes:
    """The records of the chunk at `position`, decompressed, its checksum verified.

    Args:
        stream: The file.
        position: First byte of the chunk.
        limits: What it may unpack to.
        before: Where the next chunk begins: chunks inside of one another would bring the same messages again and again.
        is_cut: The file ends inside the chunk: give the records that are whole, without a checksum over them.
        verify: Whether to hold the checksum against it.

    Raises:
        ValueError: there is no chunk, its compression is unknown, or its size or checksum is wrong.
        EOFError: the chunk reaches beyond the file.
        Exception: of the library that decompresses.
    """
    stream.seek(position)
    opcode, length = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError(f"expected a chunk at byte {position}, found a record of kind {opcode}")
    if before is not None and position + RECORD_HEAD.size + length > before:
        raise ValueError(f"chunk at byte {position}: it reaches beyond byte {before}, where the next one begins")
    head = read_chunk_head(stream)
    if head.position + head.size != position + RECORD_HEAD.size + length:
        raise ValueError(f"chunk at byte {position}: {head.size} bytes of records do not fill its {length}")
    largest = limits.max_chunk_bytes
    if head.compression:
        check_chunk_size(head.uncompressed_size, largest)
    if is_cut:
        return _whole_records(_unpacked_prefix(stream, head, largest))
    left = stream.seek(0, 2) - head.position
    if head.size > left:
        raise EOFError(f"expected {head.size} more bytes, found {left}")
    chunk = _unpacked(stream, head, largest)
    if len(chunk) != head.uncompressed_size:
        raise ValueError(f"chunk at byte {position}: expected {head.uncompressed_size} bytes, found {len(chunk)}")
    if verify and head.crc and zlib.crc32(chunk) != head.crc:
        raise ValueError(f"chunk at byte {position}: crc {zlib.crc32(chunk):#010x} instead of {head.crc:#010x}")
    return chunk


class ChunkHead(NamedTuple):
    """What a chunk says of itself; its packed records begin at byte `position` and take up `size`."""

    uncompressed_size: int
    crc: int
    compression: str
    position: int
    size: int


def read_chunk_head(stream: BinaryIO) -> ChunkHead:
    """The head of the chunk whose content begins here.

    Raises:
        EOFError: the file ends inside it.
        ValueError: the name of the compression is not one.
    """
    _, _, uncompressed_size, crc, length = CHUNK_HEAD.unpack(read_exactly(stream, CHUNK_HEAD.size))
    if length > MAX_NAME_BYTES:
        raise ValueError(f"the name of a compression of {length} bytes")
    compression = read_exactly(stream, length).decode()
    (size,) = UINT64.unpack(read_exactly(stream, UINT64.size))
    return ChunkHead(uncompressed_size, crc, compression, stream.tell(), size)


def _unpacked(stream: BinaryIO, head: ChunkHead, largest: int) -> bytes:
    stream.seek(head.position)
    data = read_exactly(stream, head.size)
    if head.compression == "":
        return data
    if head.compression == "lz4":
        return unpack_lz4(data, head.uncompressed_size, largest=largest)
    if head.compression == "zstd":
        if zstandard.frame_content_size(data) > head.uncompressed_size:
            raise ValueError(f"a chunk that unpacks to more than the {head.uncompressed_size} bytes that it names")
        return zstandard.decompress(data, head.uncompressed_size)
    raise ValueError(f"chunks compressed with {head.compression!r}, lidcam reads lz4 and zstd")


def _unpacked_prefix(stream: BinaryIO, head: ChunkHead, largest: int) -> bytes:
    stream.seek(head.position)
    if head.compression == "lz4":
        return unpack(stream, head.position, stream.seek(0, 2), "lz4", largest=largest).data
    if head.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(stream, closefd=False) as reader:
            return reader.read(head.uncompressed_size)
    if head.compression == "":
        return stream.read()
    raise ValueError(f"chunks compressed with {head.compression!r}, lidcam reads lz4 and zstd")


def _whole_records(chunk: bytes) -> bytes:
    at = 0
    while at + RECORD_HEAD.size <= len(chunk):
        _, size = RECORD_HEAD.unpack_from(chunk, at)
        if at + RECORD_HEAD.size + size > len(chunk):
            break
        at += RECORD_HEAD.size + size
    return chunk[:at]


def records_in(chunk: bytes, limits: LimitsConfig) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and size of the content of each record in a chunk.

    Raises:
        ValueError: a record does not fit the chunk, or there are too many.
    """
    at = count = 0
    while at < len(chunk):
        count += 1
        if count > limits.max_messages_per_chunk:
            raise ValueError(
                f"a chunk of more than {limits.max_messages_per_chunk} messages, see limits.max_messages_per_chunk"
            )
        opcode, size = RECORD_HEAD.unpack_from(chunk, at)
        at += RECORD_HEAD.size
        if at + size > len(chunk):
            raise ValueError(f"a record of {size} bytes reaches beyond its chunk of {len(chunk)}")
        yield opcode, at, size
        at += size


def messages_in(chunk: bytes, position: int, limits: LimitsConfig) -> Iterator[Entry]:
    """The messages of the chunk at `position`, in the order in which they lie there."""
    for opcode, at, size in records_in(chunk, limits):
        if opcode == Opcode.MESSAGE:
            yield entry_of(chunk, at, position, at, size)


def entry_of(head: bytes, at: int, chunk_position: int, start: int, size: int) -> Entry:
    """The message whose record content starts at `start`; its first fields are in `head` at `at`."""
    channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(head, at)
    if size < MESSAGE_HEAD.size:
        raise ValueError(f"a message record of {size} bytes")
    if log_time_ns >= END_OF_TIME_NS:
        raise ValueError(f"a message recorded at {log_time_ns} ns, which is no time")
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
