"""What a ROS 1 bag holds and where: from its index, or by a walk over all records where that is missing or wrong."""

from array import array
from collections import Counter, defaultdict
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, decompressors, normalize, read_bytes
from rosbags.typesys.msg import normalize_msgtype

from pipeline.core.arrays import I64
from pipeline.core.errors import RecordingError
from pipeline.core.messages import Channel
from pipeline.core.settings.recording import LimitsConfig
from readers.files.damage import Losses, describe, is_damage
from readers.files.decompress import Allowance, compression_of, unpack, unpack_lz4
from readers.files.rosbag1.records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER,
    INDEX,
    MESSAGE,
    Record,
    find_record,
    looks_like_record,
    read_record,
)

__all__ = ["Chunk", "Contents", "contents_of_index", "contents_of_walk", "load_chunk"]

MAGIC_BYTES = 13
OFFSET_END = 1 << 32


class Chunk(NamedTuple):
    """Where a chunk's data lie; `is_cut` where the file ends before they do; size 0 where that is not known."""

    data_position: int
    data_size: int
    compression: str
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Contents:
    """What a bag holds: connections by their id, chunks by their position, and the index.

    The index (N, 4) has the log time, the position of the chunk, the offset in it and the connection of every
    message, in that order.
    """

    channels: dict[int, Channel]
    chunks: dict[int, Chunk]
    index: I64


def load_chunk(stream: BinaryIO, position: int, chunk: Chunk, limits: LimitsConfig) -> bytes:
    """The records of the compressed chunk that begins at `position`.

    Raises:
        Exception: of the libraries that unpack, where it is damaged.
    """
    if chunk.compression == "lz4" and not chunk.is_cut:
        record = read_record(stream, position, chunk.data_position + chunk.data_size)
        size = record.number(b"size") if record is not None and record.kind == CHUNK else chunk.data_size
        stream.seek(chunk.data_position)
        return unpack_lz4(read_bytes(stream, chunk.data_size), size, largest=limits.max_chunk_bytes)
    end = chunk.data_position + chunk.data_size
    unpacked = unpack(stream, chunk.data_position, end, chunk.compression, largest=limits.max_chunk_bytes)
    _check_complete(chunk.compression, is_complete=unpacked.complete or chunk.is_cut)
    return unpacked.data


def _check_complete(compression: str, *, is_complete: bool) -> None:
    if not is_complete:
        raise EOFError(f"its {compression} data end early")


def contents_of_index(path: Path) -> Contents:
    """What the index of the bag says.

    Raises:
        ValueError: the index and the chunks disagree.
        Exception: of the rosbags library, where there is no index or the file is damaged.
    """
    with Reader(path) as reader:
        names = {decompress: name for name, decompress in decompressors.items()}
        channels = {
            connection.id: Channel(
                connection.topic,
                connection.msgtype,
                "ros1",
                connection.msgdef.data,
                "ros1msg",
                digest=connection.digest,
            )
            for connection in reader.connections
        }
        chunks = {
            position: Chunk(chunk.datapos, chunk.datasize, names[chunk.decompressor])
            for position, chunk in reader.chunks.items()
        }
        return Contents(channels, chunks, _index_of(reader))


def _index_of(reader: Reader) -> I64:
    parts = [
        np.column_stack([np.array(entries, np.int64), np.full(len(entries), id_, np.int64)])
        for id_, entries in reader.indexes.items()
        if entries
    ]
    reader.indexes.clear()  # eight times the size
    counted = sum(sum(chunk.connection_counts.values()) for chunk in reader.chunk_infos)
    indexed = sum(len(part) for part in parts)
    if indexed != counted:
        raise ValueError(f"the chunks hold {counted} messages, the index lists {indexed}")
    return _sorted(np.concatenate(parts) if parts else np.zeros((0, 4), np.int64))


def _sorted(index: I64) -> I64:
    return index[np.lexsort((index[:, 2], index[:, 1], index[:, 0]))]


def contents_of_walk(stream: BinaryIO, losses: Losses, *, because: str, limits: LimitsConfig) -> Contents:
    """The same by reading the whole file once, holding one chunk at a time; what cannot be read is noted.

    Args:
        stream: The file.
        losses: Gets what is damaged.
        because: Why the index was not used; noted where nothing else is found to be wrong. Empty if it may be right.
        limits: How much it may unpack to.

    Raises:
        RecordingError: it has more messages than may be held in memory.
    """
    walk = _Walk(stream, stream.seek(0, 2), limits)
    walk.run()
    return walk.contents(losses, because)


class _Walk:
    """Goes from record to record, and where there is none from the damage to the next one.

    A message lies in the chunk that was begun last; where the begin of that chunk was lost, its first message stands
    for it. What belongs together (a chunk, its damage, the index behind it) is counted under one position.
    """

    def __init__(self, stream: BinaryIO, end: int, limits: LimitsConfig) -> None:
        self._stream = stream
        self._limits = limits
        self._allowance = Allowance(limits.max_unpacked_bytes(end))
        self._end = end
        self._channels: dict[int, Channel] = {}
        self._chunks: dict[int, Chunk] = {}
        self._rows = array("q")
        self._base: int | None = None  # position of the chunk that messages lie in now
        self._part = 0  # position that they are counted under
        self._found: Counter[int] = Counter()
        self._listed: Counter[int] = Counter()  # by the index behind each chunk
        self._counted: dict[int, int] = {}  # by the chunk infos at the end of the file
        self._gaps: defaultdict[int, list[tuple[int, int, str]]] = defaultdict(list)
        self._in_index = False
        self._index_position = 0

    def run(self) -> None:
        """Go from the begin of the file to its end."""
        position = MAGIC_BYTES
        record = self._read(position)
        while position < self._end:
            if record is None:
                position = self._skip(position, position + 1)
                record = self._read(position)
                continue
            following = self._take_chunk(record) if record.kind == CHUNK else record.end
            next_record = self._read(following)
            if record.kind == MESSAGE:
                if next_record is None and not looks_like_record(self._stream, following, self._end):
                    # What follows is no record: the damage began in this message, or its length is wrong.
                    position = self._skip(position, record.data)
                    record = self._read(position)
                    continue
                self._take_message(record)
            elif record.kind == CONNECTION:
                self._take_connection(self._stream, record)
            elif record.kind != CHUNK:
                self._take_other(record)
            position, record = following, next_record

    def contents(self, losses: Losses, because: str) -> Contents:
        """What was found, and what was not."""
        index = np.array(self._rows, np.int64).reshape(-1, 4)
        known = np.isin(index[:, 3], list(self._channels))
        if not known.all():
            _, chunk, offset, _ = index[~known][0].tolist()
            lost = int((~known).sum())
            losses.note(
                self._chunks[chunk].data_position + offset,
                "messages of connections whose record was lost: their topic and type are unknown",
                messages=lost,
            )
        for part in sorted({*self._gaps, *self._found, *self._listed, *self._counted}):
            self._note(part, losses)
        if because and not losses.listed():
            if self._index_position:
                reason = f"its index cannot be used ({because}); the messages were found by reading the whole file"
                losses.note(self._index_position, reason, messages=0)
            else:
                losses.note(self._end, "it was not closed: what the recorder had not written yet is missing")
        return Contents(self._channels, self._chunks, _sorted(index[known]))

    def _note(self, part: int, losses: Losses) -> None:
        expected = self._counted.get(part, self._listed.get(part))
        found = self._found[part]
        missing = None if expected is None or expected < found else expected - found
        if gaps := self._gaps.get(part):
            position, _, reason = gaps[0]
            more = f" (and in {len(gaps) - 1} more places of the chunk)" if len(gaps) > 1 else ""
            if reason == _CUT_INDEX:
                missing = 0
            losses.note(position, reason + more, size=sum(size for _, size, _ in gaps), messages=missing)
        elif missing:
            losses.note(part, f"the index lists {expected} messages in this chunk, found {found}", messages=missing)

    def _read(self, position: int) -> Record | None:
        return read_record(self._stream, position, self._end)

    def _skip(self, position: int, search_from: int, reason: str = "") -> int:
        """Leave out what begins at `position`; where to go on."""
        following = find_record(self._stream, search_from, self._end)
        size = following - position
        if self._base is None:
            self._part = position
        if not reason:
            reason = "no record of a bag begins here: the bytes were overwritten"
            if following == self._end:
                reason = _CUT_INDEX if self._in_index else "the file ends in the middle of a record: it was cut off"
                if not self._in_index:
                    size = max(size, self._index_position - position)
        self._gaps[self._part].append((position, size, reason))
        return following

    def _take_chunk(self, record: Record) -> int:
        """Begin a chunk; where to go on: at its first record if it is not compressed, else behind it."""
        self._base, self._part, self._in_index = None, record.start, False
        self._stream.seek(record.data)
        compression = compression_of(self._stream.read(4))
        if compression == "none":
            self._base = record.start
            self._chunks[record.start] = Chunk(record.data, 0, "none")
            return record.data
        reaches_end = not record.size or record.end >= self._end
        bounded = not reaches_end and self._read(record.end) is not None
        limit = record.end if bounded else self._end
        try:
            data, used, complete = unpack(
                self._stream,
                record.data,
                limit,
                compression,
                largest=self._limits.max_chunk_bytes,
                allowance=self._allowance,
            )
            _check_complete(compression, is_complete=complete or reaches_end)
        except Exception as err:
            if not is_damage(err):
                raise
            reason = f"a chunk that does not unpack ({describe(err)})"
            if bounded:
                self._gaps[record.start].append((record.start, record.end - record.start, reason))
                return record.end
            return self._skip(record.start, record.data, reason)
        self._chunks[record.start] = Chunk(record.data, used, compression, not complete)
        whole = self._take_unpacked(data, record.start)
        if not complete:
            reason = f"the file ends in the middle of a chunk: it was cut off ({whole} bytes of it could be unpacked)"
            size = max(self._end, self._index_position) - record.start
            self._gaps[record.start].append((record.start, size, reason))
        return record.end if bounded else record.data + used

    def _take_unpacked(self, data: bytes, chunk: int) -> int:
        """The records of an unpacked chunk; how many bytes they take up."""
        stream, position, most = BytesIO(data), 0, self._limits.max_messages_per_chunk
        while (record := read_record(stream, position, len(data))) is not None and record.kind in (MESSAGE, CONNECTION):
            if record.kind == MESSAGE:
                if self._found[chunk] >= most:
                    reason = f"a chunk of more than {most} messages, see limits.max_messages_per_chunk"
                    self._gaps[chunk].append((chunk, 0, reason))
                    break
                self._add(record, chunk, record.start)
            else:
                self._take_connection(stream, record)
            position = record.end
        return position

    def _take_message(self, record: Record) -> None:
        """A message that is not compressed."""
        if self._base is not None and record.start - self._chunks[self._base].data_position >= OFFSET_END:
            self._base = None
        if self._base is None:
            self._base = record.start
            self._chunks[record.start] = Chunk(record.start, 0, "none")
        self._add(record, self._base, record.start - self._chunks[self._base].data_position)

    def _add(self, record: Record, chunk: int, offset: int) -> None:
        if len(self._rows) >= 4 * self._limits.max_messages_in_memory:
            raise RecordingError(
                f"its index is lost, and it has more than {self._limits.max_messages_in_memory} messages: raise "
                "limits.max_messages_in_memory"
            )
        self._rows.extend((record.time_ns, chunk, offset, record.number(b"conn")))
        self._found[self._part] += 1

    def _take_connection(self, stream: BinaryIO, record: Record) -> None:
        if stream is self._stream and self._base is None:
            self._in_index = True
        try:
            stream.seek(record.data - 4)  # the data have the form of a header
            fields = Header.read(stream)
            topic = normalize(record.fields[b"topic"].decode())
            msgtype = normalize_msgtype(fields.get_string("type"))
            definition, digest = fields.get_string("message_definition"), fields.get_string("md5sum")
        except (ReaderError, ValueError, LookupError):
            return  # each is recorded twice; where both are lost, its messages are counted
        channel = Channel(topic, msgtype, "ros1", definition, "ros1msg", digest=digest)
        self._channels.setdefault(record.number(b"conn"), channel)

    def _take_other(self, record: Record) -> None:
        if record.kind == INDEX:
            self._base = None
            self._listed[self._part] += record.number(b"count")
        elif record.kind == CHUNK_INFO:
            self._base, self._in_index = None, True
            self._stream.seek(record.data)
            counts = np.frombuffer(self._stream.read(record.size), "<u4")[1::2]
            self._counted[record.number(b"chunk_pos")] = int(counts.sum(dtype=np.int64))
        elif record.kind == HEADER:
            self._index_position = record.number(b"index_pos")


_CUT_INDEX = "the index at the end of the file is cut off; the messages were found by reading the whole file"
