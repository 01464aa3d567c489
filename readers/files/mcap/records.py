"""The records of an MCAP file (https://mcap.dev/spec): at a position, next after damage, in a chunk.

The unpacked size of a chunk is bounded.
"""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Header, Schema, Statistics
from mcap.stream_reader import StreamReader

from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.chunked import ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.decompress import check_chunk_size, unpack

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the content
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, unpacked size, crc, length of the compression's name
UINT64 = struct.Struct("<Q")

COMPRESSIONS = frozenset({"", "lz4", "zstd"})
MAX_NAME_BYTES = 32
END_OF_TIME_NS = 1 << 63
"""MCAP times are unsigned 64-bit integers, those of lidcam signed ones."""

INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of pairs of log time and offset
PAIR_BYTES = 16

MIN_BYTES: dict[int, int] = {
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: MESSAGE_HEAD.size,
    Opcode.CHUNK: CHUNK_HEAD.size + UINT64.size,
    Opcode.MESSAGE_INDEX: INDEX_HEAD.size,
    Opcode.STATISTICS: 46,
    Opcode.DATA_END: 4,
}
MAX_BYTES: dict[int, int] = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}

OPCODES = range(Opcode.HEADER, Opcode.DATA_END + 1)
PRIVATE_OPCODES = range(0x80, 0x100)
"""Records of applications, which readers skip."""

# An opcode, and a length below 2^40.
RECORD_START = re.compile(rb"(?s)(?=[\x01-\x0f].{5}\x00{3}).")
FIRST_BLOCK, SEARCH_BLOCK = 1 << 12, 1 << 20
"""Bytes that are searched at once, more from one time to the next: what is sought is mostly near."""


class ChunkHead(NamedTuple):
    """The fields of a chunk; its compressed records begin at byte `position` of the file and take up `size` bytes."""

    uncompressed_size: int
    crc: int
    compression: str
    position: int
    size: int


def load_chunk(stream: BinaryIO, position: int, limits: RecordingLimits, *, size: int | None = None) -> bytes:
    """The records of the chunk at `position`, decompressed, their checksum verified. `size` is that of the index."""
    stream.seek(position)
    opcode, length = RECORD_HEAD.unpack(read_exactly(stream, RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError(f"expected a chunk at byte {position}, found a record with opcode {opcode}")
    if size is not None and RECORD_HEAD.size + length != size:
        raise ValueError(f"chunk at byte {position}: {RECORD_HEAD.size + length} bytes, the index says {size}")
    head = read_chunk_head(stream)
    if head.position + head.size != position + RECORD_HEAD.size + length:
        raise ValueError(f"chunk at byte {position}: {head.size} bytes of records do not fill its {length}")
    largest = limits.max_chunk_bytes
    if head.compression not in COMPRESSIONS:
        raise ValueError(f"chunks compressed with {head.compression!r}, lidcam reads lz4 and zstd")
    if head.compression:
        check_chunk_size(head.uncompressed_size, largest)
    left = stream.seek(0, 2) - head.position
    if head.size > left:
        raise EOFError(f"expected {head.size} more bytes, found {left}")
    chunk = _unpacked(stream, head, largest)
    if len(chunk) != head.uncompressed_size:
        raise ValueError(f"chunk at byte {position}: expected {head.uncompressed_size} bytes, found {len(chunk)}")
    if head.crc and zlib.crc32(chunk) != head.crc:
        raise ValueError(f"chunk at byte {position}: crc {zlib.crc32(chunk):#010x} instead of {head.crc:#010x}")
    return chunk


def read_chunk_head(stream: BinaryIO) -> ChunkHead:
    """The fields of the chunk whose content begins here."""
    _, _, uncompressed_size, crc, length = CHUNK_HEAD.unpack(read_exactly(stream, CHUNK_HEAD.size))
    if length > MAX_NAME_BYTES:
        raise ValueError(f"the name of a compression has {length} bytes")
    compression = read_exactly(stream, length).decode()
    (size,) = UINT64.unpack(read_exactly(stream, UINT64.size))
    return ChunkHead(uncompressed_size, crc, compression, stream.tell(), size)


def _unpacked(stream: BinaryIO, head: ChunkHead, largest: int) -> bytes:
    if head.compression == "lz4":
        end, size = head.position + head.size, head.uncompressed_size
        return unpack(stream, head.position, end, "lz4", largest=largest, size=size).data
    stream.seek(head.position)
    data = read_exactly(stream, head.size)
    if head.compression == "":
        return data
    if zstandard.frame_content_size(data) > head.uncompressed_size:
        raise ValueError(f"a chunk unpacks to more than the {head.uncompressed_size} bytes that it names")
    return zstandard.decompress(data, head.uncompressed_size)


def records_in(chunk: bytes, limits: RecordingLimits) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and size of the content of each record in a chunk."""
    at = count = 0
    while at < len(chunk):
        count += 1
        if count > limits.max_messages_per_chunk:
            raise ValueError(f"a chunk of more than {limits.max_messages_per_chunk} messages, see limit_scale")
        opcode, size = RECORD_HEAD.unpack_from(chunk, at)
        at += RECORD_HEAD.size
        if at + size > len(chunk):
            raise ValueError(f"a record of {size} bytes reaches beyond its chunk of {len(chunk)}")
        yield opcode, at, size
        at += size


def entry_of(head: bytes, at: int, chunk_position: int, start: int, size: int) -> Entry:
    """The message whose record content starts at `start`; its first fields are in `head` at `at`."""
    channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(head, at)
    if size < MESSAGE_HEAD.size:
        raise ValueError(f"a message record of {size} bytes")
    if log_time_ns >= END_OF_TIME_NS:
        raise ValueError(f"a message with log time {log_time_ns} ns, expected less than 2^63")
    return Entry(log_time_ns, chunk_position, start + MESSAGE_HEAD.size, size - MESSAGE_HEAD.size, channel_id)


class Record(NamedTuple):
    """One record: its content begins at byte `content` and takes up `size`."""

    opcode: int
    start: int
    content: int
    size: int

    @property
    def end(self) -> int:
        """The byte after it."""
        return self.content + self.size


def record_at(stream: BinaryIO, position: int, end: int) -> Record | None:
    """The record at `position`; None if no complete record begins there."""
    record = _frame_at(stream, position, end)
    if record is None:
        return None
    opcode, size = record.opcode, record.size
    if opcode in PRIVATE_OPCODES:  # any bytes may look like one, so look at what follows
        return record if record.end == end or _frame_at(stream, record.end, end) else None
    if not MIN_BYTES.get(opcode, 0) <= size <= MAX_BYTES.get(opcode, size):
        return None
    if opcode == Opcode.MESSAGE_INDEX:
        _, listed = INDEX_HEAD.unpack(stream.read(INDEX_HEAD.size))
        return record if size == listed + INDEX_HEAD.size and not listed % PAIR_BYTES else None
    if opcode == Opcode.CHUNK:
        try:
            head = read_chunk_head(stream)
        except (EOFError, ValueError):
            return None
        return record if head.position + head.size == record.end else None
    return record


def _frame_at(stream: BinaryIO, position: int, end: int) -> Record | None:
    """A record by its opcode and length alone."""
    if position + RECORD_HEAD.size > end:
        return None
    stream.seek(position)
    opcode, size = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    content = position + RECORD_HEAD.size
    if content + size > end or (opcode not in OPCODES and opcode not in PRIVATE_OPCODES):
        return None
    return Record(opcode, position, content, size)


def find_record(stream: BinaryIO, position: int, end: int) -> int:
    """Start of the next records at or after `position`; `end` if there are none."""
    step = FIRST_BLOCK
    while position < end:
        stream.seek(position)
        block = stream.read(min(step, end - position))
        for match in RECORD_START.finditer(block):
            if _begins(stream, position + match.start(), end):
                return position + match.start()
        if position + len(block) >= end:
            return end
        position += len(block) - RECORD_HEAD.size
        step = min(2 * step, SEARCH_BLOCK)
    return end


def _begins(stream: BinaryIO, position: int, end: int) -> bool:
    """Whether a chunk, or three records in a row, begin at `position`."""
    for _ in range(3):
        record = record_at(stream, position, end)
        if record is None:
            return False
        if record.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX} or record.end == end:
            return True
        position = record.end
    return True


FOOTER = struct.Struct("<BQQQI")  # record head, start of the summary, start of its offsets, crc of the summary
MAGIC_BYTES = 8
BLOCK_BYTES = 1 << 20
MAX_RECORD_BYTES = 1 << 26
"""Largest record of a summary: a schema, or the index of a chunk."""


@dataclass(slots=True)
class Contents:
    """Contents of a file, and their places."""

    schemas: dict[int, Schema] = field(default_factory=dict)  # By id
    channels: dict[int, Channel] = field(default_factory=dict)  # By id
    counts: Counter[int] = field(default_factory=Counter)  # Number of messages by channel id
    chunks: list[ChunkPlace] = field(default_factory=list)  # Where the chunks are
    loose: list[Entry] = field(default_factory=list)  # Messages outside of chunks
    start_ns: int = 2**64  # Log time of the first message
    end_ns: int = 0  # Log time of the last message (inclusive)


def _reader(stream: BinaryIO, position: int, whence: int = 0) -> StreamReader:
    """Records from a position on, chunks as they are."""
    stream.seek(position, whence)
    return StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES)


def read_profile(stream: BinaryIO) -> str:
    """The profile that the header names."""
    header = next(_reader(stream, MAGIC_BYTES).records)
    if not isinstance(header, Header):
        raise McapError(f"expected a header, found {type(header).__name__}")
    return header.profile


def contents_of_summary(stream: BinaryIO) -> Contents | None:
    """Contents according to the summary section; None if it lacks something."""
    footer = next(_reader(stream, -FOOTER.size - MAGIC_BYTES, 2).records)
    if not isinstance(footer, Footer):
        raise McapError(f"expected a footer, found {type(footer).__name__}")
    if not is_summary_sound(stream):
        raise ValueError("the checksum of its summary is wrong")
    contents = Contents()
    statistics: Statistics | None = None
    for record in _reader(stream, footer.summary_start).records if footer.summary_start else ():
        match record:
            case Statistics():
                statistics = record
            case Schema():
                contents.schemas[record.id] = record
            case Channel():
                contents.channels[record.id] = record
            case ChunkIndex():
                contents.chunks.append(_place_of(record))
    if statistics is None:
        return None
    contents.counts = Counter(statistics.channel_message_counts)
    contents.start_ns, contents.end_ns = statistics.message_start_time, statistics.message_end_time
    counts = [place.messages for place in contents.chunks if place.messages is not None]
    if len(counts) == len(contents.chunks) and counts and sum(counts) != statistics.message_count:
        raise ValueError(
            f"its statistics say {statistics.message_count} messages, the index of its chunks {sum(counts)}"
        )
    is_complete = (
        contents.counts.total() == statistics.message_count
        and len(contents.chunks) == statistics.chunk_count
        and (contents.chunks or not statistics.message_count)
        and contents.counts.keys() <= contents.channels.keys()
        and {channel.schema_id for channel in contents.channels.values()} <= {0, *contents.schemas}
    )
    return contents if is_complete else None


def _place_of(record: ChunkIndex) -> ChunkPlace:
    """A chunk by its record in the summary; the size of the message indexes behind it says how many messages it has."""
    ids = frozenset(record.message_index_offsets)
    pairs, rest = divmod(record.message_index_length - len(ids) * (RECORD_HEAD.size + INDEX_HEAD.size), PAIR_BYTES)
    count = pairs if ids and not rest and pairs >= 0 else None
    start_ns, end_ns = record.message_start_time, record.message_end_time
    return ChunkPlace(start_ns, record.chunk_start_offset, end_ns, ids, record.chunk_length, count)


def is_summary_sound(stream: BinaryIO) -> bool:
    """Whether the summary has the checksum (CRC-32) that the footer names, if it names one."""
    end = stream.seek(-FOOTER.size - MAGIC_BYTES, 2)
    _, _, start, _, crc = FOOTER.unpack(read_exactly(stream, FOOTER.size))
    if not crc or not start:
        return True
    stream.seek(start)
    found, left = 0, end + FOOTER.size - 4 - start  # all but itself
    while left > 0:
        block = read_exactly(stream, min(left, BLOCK_BYTES))
        found, left = zlib.crc32(block, found), left - len(block)
    return bool(found == crc)


def end_of_records(stream: BinaryIO) -> int:
    """End of the last record: before the magic bytes, if the file ends with them."""
    size = stream.seek(0, 2)
    stream.seek(0)
    magic = stream.read(MAGIC_BYTES)
    stream.seek(max(size - MAGIC_BYTES, 0))
    return size - MAGIC_BYTES if size > MAGIC_BYTES and stream.read() == magic else size
