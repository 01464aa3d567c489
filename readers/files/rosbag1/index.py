"""What a ROS 1 bag contains and where, according to its index.

Everything that the file says twice is compared, because no part of an index has a checksum: the counts in the header
with the records at the end, the chunks with one another (no byte between them is unexplained), and the index behind
each chunk with the counts and times at the end of the file. Only the chunks themselves stay unread.
"""

import struct
from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from typing import BinaryIO, Literal, NamedTuple

import numpy as np

from pipeline.core.arrays import I64
from readers.files.rosbag1.connections import Connection, connection_of
from readers.files.rosbag1.records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER,
    INDEX,
    MAGIC_BYTES,
    Record,
    read_record,
)
from readers.files.rows import counts_of, sort_rows

__all__ = ["BY_TIME", "Chunk", "Contents", "contents_of_index"]

COMPRESSIONS = {b"none": "none", b"bz2": "bz2", b"lz4": "lz4"}
ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])
UINT32_PAIR = struct.Struct("<II")
BY_TIME = (0, 1, 2)
"""Columns of `Contents.index` that it is sorted by: log time, chunk, offset."""

INDEX_HEADERS_BYTES = 1 << 20
"""Of all index records behind a chunk, at most; one takes 55 bytes."""


class Chunk(NamedTuple):
    """Where a chunk's data are.

    Attributes:
        data_position: First byte of the data.
        data_size: Bytes of the data; 0 if unknown.
        compression: `none`, `bz2` or `lz4`.
        is_cut: Whether the file ends inside them.
        start_ns: Log time of its first message, according to the end of the file.
        end_ns: Log time of its last message (inclusive), likewise.
        index_size: Bytes of the index records behind the data; 0 if unknown.
    """

    data_position: int
    data_size: int
    compression: str
    is_cut: bool = False
    start_ns: int = 0
    end_ns: int = 2**63 - 1
    index_size: int = 0


@dataclass(frozen=True, slots=True)
class Contents:
    """What a bag contains and where.

    Attributes:
        connections: By number.
        chunks: By position in the file.
        index: (N, 4) log time, position of the chunk, offset in it, and connection id of every message; sorted.
        found_by: Whether this is what the index says, or what was found in the chunks themselves.
    """

    connections: dict[int, Connection]
    chunks: dict[int, Chunk]
    index: I64
    found_by: Literal["index", "scan"] = "index"

    def rows_of(self, position: int) -> I64:
        """(N, 3) log time, offset and connection id of all messages of a chunk whose times the index says."""
        chunk, times_ns = self.chunks[position], self.index[:, 0]  # numpy's search would copy all times
        rows = self.index[bisect_left(times_ns, chunk.start_ns) : bisect_right(times_ns, chunk.end_ns)]
        found: I64 = rows[rows[:, 1] == position][:, (0, 2, 3)]
        return found


class _ChunkInfo(NamedTuple):
    """What the end of the file says of a chunk: times, and the number of messages by connection id."""

    start_ns: int
    end_ns: int
    counts: Counter[int]


def contents_of_index(stream: BinaryIO) -> Contents:
    """What the index of the bag says.

    Raises:
        ValueError: there is no index, or it contradicts itself or the places of the chunks.
        Exception: any that damage causes.
    """
    end = stream.seek(0, 2)
    header = _required(stream, MAGIC_BYTES, end, HEADER, "the header")
    if header.fields.get(b"encryptor"):
        raise ValueError(f"it is encrypted ({header.fields[b'encryptor'].decode(errors='replace')})")
    index_position = header.number(b"index_pos")
    if not index_position:
        raise ValueError("it was not closed, and has no index")
    connections, infos = _end_of_file(stream, index_position, end)
    said = header.number(b"conn_count"), header.number(b"chunk_count")
    if said != (len(connections), len(infos)):
        raise ValueError(
            f"its header says {said[0]} connections and {said[1]} chunks, "
            f"the index lists {len(connections)} and {len(infos)}"
        )
    chunks: dict[int, Chunk] = {}
    count = sum(info.counts.total() for info in infos.values())
    if count * ENTRY.itemsize > end:
        raise ValueError(f"the index lists {count} messages, more than a file of {end} bytes holds")
    index = np.empty((count, 4), np.int64)
    filled = 0
    starts = [*sorted(infos), index_position]
    if header.end != starts[0]:
        raise ValueError(f"its first chunk is expected at byte {header.end}, the index says {starts[0]}")
    for position, following in pairwise(starts):
        chunks[position], rows = _chunk(stream, position, following, infos[position])
        sort_rows(rows, BY_TIME)  # mostly, nothing is left to be sorted then
        index[filled : filled + len(rows)] = rows
        filled += len(rows)
    sort_rows(index, BY_TIME)
    if unknown := counts_of(index[:, 3]).keys() - connections.keys():
        raise ValueError(f"it has messages of connection {min(unknown)}, which the index does not list")
    return Contents(connections, chunks, index)


def _required(stream: BinaryIO, position: int, end: int, kind: int, name: str) -> Record:
    record = read_record(stream, position, end)
    if record is None or record.kind != kind or record.end > end:
        raise ValueError(f"expected {name} at byte {position}")
    return record


def _end_of_file(stream: BinaryIO, position: int, end: int) -> tuple[dict[int, Connection], dict[int, _ChunkInfo]]:
    """The connections by id, and what is said of the chunks by position: all records from `position` to the end."""
    connections: dict[int, Connection] = {}
    infos: dict[int, _ChunkInfo] = {}
    while position < end:
        record = read_record(stream, position, end)
        if record is not None and record.kind == CONNECTION and not infos:
            id_ = record.number(b"conn")
            if id_ in connections:
                raise ValueError(f"the index lists connection {id_} twice")
            connections[id_] = connection_of(stream, record)
        elif record is not None and record.kind == CHUNK_INFO and record.number(b"ver") == 1:
            stream.seek(record.data)
            counts = Counter(dict(UINT32_PAIR.iter_unpack(stream.read(record.size))))
            if record.number(b"chunk_pos") in infos or len(counts) != record.number(b"count"):
                raise ValueError(f"the index lists a chunk or one of its connections twice at byte {position}")
            span = record.time_of(b"start_time"), record.time_of(b"end_time")
            infos[record.number(b"chunk_pos")] = _ChunkInfo(*span, counts)
        else:
            raise ValueError(f"expected a record of the index at byte {position}")
        position = record.end
    return connections, infos


def _chunk(stream: BinaryIO, position: int, following: int, info: _ChunkInfo) -> tuple[Chunk, I64]:
    """A chunk and the rows of its messages, from the records between it and the next one at `following`.

    Raises:
        ValueError: they do not fill the place between, or do not agree with `info`.
    """
    record = _required(stream, position, following, CHUNK, "a chunk")
    compression = COMPRESSIONS.get(record.fields[b"compression"])
    if compression is None:
        raise ValueError(f"the chunk at byte {position} has an unknown compression")
    unpacked_size = record.number(b"size")
    if compression == "none" and unpacked_size != record.size:
        raise ValueError(f"the chunk at byte {position} gives two sizes, {unpacked_size} and {record.size}")
    size = following - record.end
    largest = info.counts.total() * ENTRY.itemsize + INDEX_HEADERS_BYTES
    if size > largest:  # perhaps whole chunks that the index does not list: they are not read into memory
        raise ValueError(
            f"the chunk at byte {position} has {size} bytes behind it, its index takes at most {largest} of them"
        )
    chunk = Chunk(record.data, record.size, compression, False, info.start_ns, info.end_ns, size)
    counts, listed = _listed(stream, chunk, position)
    if +counts != +info.counts:
        raise ValueError(
            f"the chunk at byte {position} has {info.counts.total()} messages according to the end of the file, "
            f"{counts.total()} according to the index behind it"
        )
    rows = np.empty((len(listed), 4), np.int64)
    rows[:, (0, 2, 3)] = listed
    rows[:, 1] = position
    _check_entries(rows, position, unpacked_size, info)
    return chunk, rows


def _listed(stream: BinaryIO, chunk: Chunk, position: int) -> tuple[Counter[int], I64]:
    """Number of messages that the index behind a chunk lists, by connection id, and (N, 3) times, offsets and ids."""
    size, at = chunk.index_size, 0
    stream.seek(chunk.data_position + chunk.data_size)
    behind = stream.read(size)
    indexes = BytesIO(behind)
    entries: list[bytes] = []
    counts: Counter[int] = Counter()
    while at < size:
        index = _required(indexes, at, size, INDEX, f"an index of the chunk at byte {position}, {at} bytes behind it,")
        id_ = index.number(b"conn")
        if index.number(b"ver") != 1 or id_ in counts:
            raise ValueError(f"an index of the chunk at byte {position} has another version, or comes twice")
        entries.append(behind[index.data : index.end])
        counts[id_] = index.number(b"count")
        at = index.end
    listed = np.frombuffer(b"".join(entries), ENTRY)
    rows = np.empty((len(listed), 3), np.int64)
    rows[:, 0] = listed["sec"] * np.int64(10**9) + listed["nanosec"]
    rows[:, 1] = listed["offset"]
    rows[:, 2] = np.repeat([*counts], [*counts.values()]) if counts else 0
    return counts, rows


def _check_entries(rows: I64, position: int, size: int, info: _ChunkInfo) -> None:
    """Refuse an index whose entries cannot all be right."""
    if not len(rows):
        return
    if len(np.unique(rows[:, 2])) != len(rows) or rows[:, 2].max() >= size:
        raise ValueError(f"the index of the chunk at byte {position} names a message twice, or outside of the chunk")
    if rows[:, 0].min() < info.start_ns or rows[:, 0].max() > info.end_ns:
        raise ValueError(f"the index of the chunk at byte {position} names times that the chunk does not cover")
