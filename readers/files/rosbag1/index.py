"""Contents of a ROS 1 bag according to its index: connections, and chunks with times and counts."""

import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import Header, normalize
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.messages import Channel
from lidcam.readers.files.chunked import ChunkPlace
from lidcam.readers.files.rosbag1.records import CHUNK, CHUNK_INFO, CONNECTION, HEADER, MAGIC_BYTES, Record, read_record

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
    """Contents according to the index of the bag.

    Raises:
        ValueError: there is no index, or it does not agree with the header or the chunks.
        Exception: any that damage causes.
    """
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
    """The channel that a record of a connection describes.

    Raises:
        Exception: any that damage causes.
    """
    stream.seek(record.data - 4)  # the data and their length have the form of a header
    fields = Header.read(BytesIO(stream.read(record.size + 4)))
    topic = normalize(record.fields[b"topic"].decode())
    msgtype = normalize_msgtype(fields.get_string("type"))
    definition, digest = fields.get_string("message_definition"), fields.get_string("md5sum")
    return Channel(topic, msgtype, "ros1", definition, "ros1msg", digest=digest)


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
