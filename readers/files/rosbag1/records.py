"""The records of a ROS 1 bag, format 2.0: the one at a position, or the next one after damage."""

import re
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from itertools import islice
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import normalize
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.messages import Channel
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.chunked import ChunkPlace

MAGIC_BYTES = 13
"""The first record begins behind these."""

MESSAGE = 2
HEADER = 3
INDEX = 4
CHUNK = 5
CHUNK_INFO = 6
CONNECTION = 7

FIELDS: dict[int, dict[bytes, int | None]] = {
    MESSAGE: {b"conn": 4, b"time": 8},
    HEADER: {b"index_pos": 8, b"conn_count": 4, b"chunk_count": 4},
    INDEX: {b"ver": 4, b"conn": 4, b"count": 4},
    CHUNK: {b"compression": None, b"size": 4},
    CHUNK_INFO: {b"ver": 4, b"chunk_pos": 8, b"start_time": 8, b"end_time": 8, b"count": 4},
    CONNECTION: {b"conn": 4, b"topic": None},
}
"""Required fields of each kind of record, with their sizes in bytes."""

ENTRY_BYTES = {INDEX: 12, CHUNK_INFO: 8}

UINT32 = struct.Struct("<I")

HEAD_BYTES = 64
"""First bytes of a record that are read at once."""

MESSAGE_BEGIN = re.compile(
    rb"(?s)\x26\0\0\0(?:\x09\0\0\0conn=(....)|\x04\0\0\0op=(\x02)|\x0d\0\0\0time=(.{8})){3}(....)"
)
"""The header of a message without other fields, in any order, and the length of its data: nearly all records."""

MAX_HEADER_BYTES = 1 << 12
"""Longest header of a record in bytes: its longest field is the name of a topic."""

MAX_FIELDS = 32

FIRST_BLOCK, SEARCH_BLOCK = 1 << 12, 1 << 20
"""Bytes that are searched at once, more from one time to the next: what is sought is mostly near."""

# Length of the header, length of its first field, name of that field; the upper bytes of both lengths are zero.
RECORD_START = re.compile(
    rb"(?s)..\x00\x00..\x00\x00"
    rb"(?=(?:op|conn|conn_count|compression|chunk_pos|chunk_count|count|index_pos|topic|size|time|start_time|end_time|ver)=)"
)
MAX_START_BYTES = 8 + len(b"chunk_count=")


class Record(NamedTuple):
    """One record: `kind` is its `op`, its data begin at byte `data` and take up `size`."""

    kind: int
    fields: dict[bytes, bytes]
    start: int
    data: int
    size: int

    @property
    def end(self) -> int:
        """The byte after it."""
        return self.data + self.size

    def number(self, name: bytes) -> int:
        """An unsigned field."""
        return int.from_bytes(self.fields[name], "little")

    def time_of(self, name: bytes) -> int:
        """A field that is a time, in nanoseconds."""
        seconds, nanoseconds = struct.unpack("<II", self.fields[name])
        return int(seconds) * 10**9 + int(nanoseconds)


def read_record(stream: BinaryIO, position: int, end: int) -> Record | None:
    """The record at `position` of a file or an unpacked chunk; None if no complete one begins there before `end`.

    Only chunks may reach beyond the end.
    """
    if position + 8 > end:
        return None
    stream.seek(position)
    begin = stream.read(HEAD_BYTES)
    if match := MESSAGE_BEGIN.match(begin):
        conn, op, time, size_bytes = match.groups()
        if conn is not None and op is not None and time is not None:
            (size,) = UINT32.unpack(size_bytes)
            record = Record(MESSAGE, {b"conn": conn, b"time": time}, position, position + match.end(), size)
            return record if record.end <= end else None
    (length,) = UINT32.unpack_from(begin)
    data = position + 8 + length
    if length > MAX_HEADER_BYTES or data > end:
        return None
    if length + 8 > len(begin):
        begin += stream.read(length + 8 - len(begin))
    content = begin[4 : length + 8]
    parsed = _fields(content[:length])
    if parsed is None or len(parsed.get(b"op", b"")) != 1:
        return None
    kind = parsed[b"op"][0]
    for name, width in FIELDS.get(kind, {b"": None}).items():
        if name not in parsed or (width is not None and len(parsed[name]) != width):
            return None
    (size,) = UINT32.unpack_from(content, length)
    record = Record(kind, parsed, position, data, size)
    if kind in ENTRY_BYTES and size != record.number(b"count") * ENTRY_BYTES[kind]:
        return None
    return record if kind == CHUNK or record.end <= end else None


def find_record(stream: BinaryIO, position: int, end: int) -> int:
    """Start of the next complete record at or after `position`; `end` if there is none."""
    step = FIRST_BLOCK
    while position < end:
        stream.seek(position)
        block = stream.read(min(step, end - position))
        at = 0 if b"=" in block else len(block)  # zeros look like a record to the pattern for long
        while match := RECORD_START.search(block, at):
            start = position + match.start()
            if read_record(stream, start, end) is not None:
                return start
            at = match.start() + 1
        if position + len(block) >= end or len(block) <= MAX_START_BYTES:
            return end
        position += len(block) - MAX_START_BYTES
        step = min(2 * step, SEARCH_BLOCK)
    return end


def _records_of(stream: BinaryIO, begin: int, end: int) -> Iterator[Record]:
    position, record = begin, read_record(stream, begin, end)
    while position < end:
        following = None if record is None else read_record(stream, record.end, end)
        if (
            record is None
            or record.kind not in {MESSAGE, CONNECTION}
            or (following is None and record.end != end)  # its length is wrong
        ):
            position = find_record(stream, position + 1 if record is None else record.data, end)
            record = read_record(stream, position, end)
            continue
        yield record
        position, record = record.end, following


def contents_of_chunk(records: bytes, limits: RecordingLimits) -> list[Record]:
    """The messages and connections of an unpacked chunk; damage is passed over."""
    found = list(islice(_records_of(BytesIO(records), 0, len(records)), limits.max_messages_per_chunk + 1))
    if len(found) > limits.max_messages_per_chunk:
        raise ValueError(f"a chunk of more than {limits.max_messages_per_chunk} messages, see limit_scale")
    return found


def looks_like_record(stream: BinaryIO, position: int, end: int) -> bool:
    """Whether a record that is damaged, or cut off by the end, seems to begin at `position`."""
    stream.seek(position)
    head = stream.read(min(64, end - position))
    return len(head) < 64 or any(name + b"=" in head for names in FIELDS.values() for name in names)


def _fields(header: bytes) -> dict[bytes, bytes] | None:
    fields: dict[bytes, bytes] = {}
    at = count = 0
    while at < len(header):
        count += 1
        if at + 4 > len(header) or count > MAX_FIELDS:
            return None
        (length,) = UINT32.unpack_from(header, at)
        name, separator, value = header[at + 4 : at + 4 + length].partition(b"=")
        at += 4 + length
        if not separator or at > len(header):
            return None
        fields[name] = value
    return fields


COMPRESSIONS = frozenset({"none", "bz2", "lz4"})
UINT32_PAIR = struct.Struct("<II")


class ChunkData(NamedTuple):
    """Place of a chunk's data."""

    position: int  # First byte of the data
    size: int  # Bytes of the data in the file
    unpacked_size: int  # Bytes of the records, as far as the file says
    compression: str  # `none`, `bz2` or `lz4`
    is_cut: bool = False  # Whether the file ends inside them


@dataclass(slots=True)
class Contents:
    """Contents of a bag, and their places."""

    channels: dict[int, Channel] = field(default_factory=dict)  # By number of the connection
    # Where the chunks are. A scan makes several of an uncompressed one that is damaged
    chunks: list[ChunkPlace] = field(default_factory=list)
    data: dict[int, ChunkData] = field(default_factory=dict)  # Their data by position of the chunk
    counts: Counter[int] = field(default_factory=Counter)  # Number of messages by connection


def contents_of_index(stream: BinaryIO) -> Contents:
    """Contents according to the index of the bag."""
    end = stream.seek(0, 2)
    header = _required(stream, MAGIC_BYTES, end, HEADER)
    position = index_position = header.number(b"index_pos")
    if not position:
        raise ValueError("it was not closed, and has no index")
    contents = Contents()
    while position < end:
        record = read_record(stream, position, end)
        if record is None or record.kind not in {CONNECTION, CHUNK_INFO}:
            raise ValueError(f"expected a record of the index at byte {position}")
        if record.kind == CONNECTION:
            contents.channels[record.number(b"conn")] = channel_of(stream, record)
        else:
            _take_chunk(stream, record, index_position, contents)
        position = record.end
    said = header.number(b"conn_count"), header.number(b"chunk_count")
    found = len(contents.channels), len(contents.data)
    if said != found:
        raise ValueError(
            f"its header says {said[0]} connections and {said[1]} chunks, the index lists {found[0]} and {found[1]}"
        )
    if unknown := contents.counts.keys() - contents.channels.keys():
        raise ValueError(f"it has messages of connection {min(unknown)}, which the index does not list")
    return contents


def channel_of(stream: BinaryIO, record: Record) -> Channel:
    """The channel that a record of a connection describes."""
    stream.seek(record.data)
    fields = {name: value.decode() for name, value in (_fields(stream.read(record.size)) or {}).items()}
    topic = normalize(record.fields[b"topic"].decode())
    msgtype = normalize_msgtype(fields[b"type"])
    return Channel(topic, msgtype, "ros1", fields[b"message_definition"], "ros1msg", digest=fields[b"md5sum"])


def _required(stream: BinaryIO, position: int, end: int, kind: int) -> Record:
    record = read_record(stream, position, end)
    if record is None or record.kind != kind or record.end > end:
        raise ValueError(f"expected a record of kind {kind} at byte {position}")
    return record


def _take_chunk(stream: BinaryIO, info: Record, end: int, contents: Contents) -> None:
    """Add the chunk that a record at the end of the file describes."""
    stream.seek(info.data)
    counts = Counter(dict(UINT32_PAIR.iter_unpack(stream.read(info.size))))
    position = info.number(b"chunk_pos")
    record = _required(stream, position, end, CHUNK)
    compression = record.fields[b"compression"].decode(errors="replace")
    if compression not in COMPRESSIONS:
        raise ValueError(f"the chunk at byte {position} has an unknown compression")
    contents.data[position] = ChunkData(record.data, record.size, record.number(b"size"), compression)
    first_ns, last_ns = info.time_of(b"start_time"), info.time_of(b"end_time")
    size = record.end - position
    contents.chunks.append(ChunkPlace(first_ns, position, last_ns, frozenset(+counts), size, counts.total()))
    contents.counts += counts
