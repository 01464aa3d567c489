"""What a ROS 1 bag contains, found by a scan of all its records that resumes after damage."""

from array import array
from collections import Counter, defaultdict
from io import BytesIO
from typing import BinaryIO

import numpy as np

from pipeline.core.errors import RecordingError
from pipeline.core.settings.recording import LimitsConfig
from readers.files.damage import Losses
from readers.files.decompress import Allowance, compression_of, unpack
from readers.files.rosbag1.chunk import check_complete
from readers.files.rosbag1.connections import Connection, agreed, connection_of, is_same
from readers.files.rosbag1.index import BY_TIME, Chunk, Contents
from readers.files.rosbag1.records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER,
    INDEX,
    MAGIC_BYTES,
    MESSAGE,
    Record,
    find_record,
    looks_like_record,
    read_record,
)
from readers.files.rows import sort_rows

__all__ = ["contents_of_scan"]

OFFSET_END = 1 << 32
CUT_INDEX = "the index at the end of the file is cut off; the messages were found by reading the whole file"


def contents_of_scan(stream: BinaryIO, losses: Losses, *, because: str, limits: LimitsConfig) -> Contents:
    """The contents, found by reading the whole file once; one chunk at a time is in memory.

    Args:
        stream: The file.
        losses: Collects what is damaged.
        because: Why the index is invalid; noted if no other damage is found. Empty if it may be valid.
        limits: How much the file may unpack to.

    Raises:
        RecordingError: it has more messages than may be held in memory.
    """
    scan = _Scan(stream, stream.seek(0, 2), losses, limits)
    scan.run()
    return scan.contents(because)


class _Scan:
    """Reads one record after the other; after damage it searches for the next one.

    A message belongs to the last chunk that began; if the beginning of that chunk was lost, its first message stands
    for it. A chunk, its damage and the index after it are counted under one position.
    """

    def __init__(self, stream: BinaryIO, end: int, losses: Losses, limits: LimitsConfig) -> None:
        self._stream = stream
        self._losses = losses
        self._limits = limits
        self._allowance = Allowance(limits.max_unpacked_bytes(end))
        self._end = end
        self._connections: dict[int, Connection] = {}
        self._chunks: dict[int, Chunk] = {}
        self._rows = array("q")
        self._base: int | None = None  # position of the current chunk
        self._part = 0  # position under which its messages are counted
        self._found: Counter[int] = Counter()
        self._listed: Counter[int] = Counter()  # according to the index after each chunk
        self._counted: dict[int, int] = {}  # according to the chunk infos at the end of the file
        self._gaps: defaultdict[int, list[tuple[int, int, str]]] = defaultdict(list)
        self._in_index = False
        self._index_position = 0
        self._chunk_count = 0  # according to the header

    def run(self) -> None:
        """Scan from the beginning of the file to its end."""
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

    def contents(self, because: str) -> Contents:
        """What was found; what was lost is noted."""
        losses = self._losses
        index = np.frombuffer(self._rows, np.int64).reshape(-1, 4)
        known = np.isin(index[:, 3], list(self._connections))
        if not known.all():
            _, chunk, offset, _ = index[~known][0].tolist()
            lost = int((~known).sum())
            losses.note(
                self._chunks[chunk].data_position + offset,
                "messages of connections whose record was lost: their topic and type are unknown",
                messages=lost,
            )
            index = index[known]
        self._match_counts()
        for part in sorted({*self._gaps, *self._found, *self._listed, *self._counted}):
            self._note(part)
        if because and not losses.listed():
            if self._index_position:
                reason = f"its index cannot be used ({because}); the messages were found by reading the whole file"
                losses.note(self._index_position, reason, messages=0)
            else:
                losses.note(self._end, "it was not closed: what the recorder had not written yet is missing")
        sort_rows(index, BY_TIME)
        return Contents(self._connections, self._chunks, index, "scan")

    def _match_counts(self) -> None:
        """Give counts at the end of the file that name no chunk to the chunks without one: a position was damaged."""
        nameless = [part for part in sorted(self._counted) if part not in self._chunks and not self._gaps.get(part)]
        uncounted = [part for part in sorted(self._found) if part not in self._counted]
        for part in nameless:
            match = next((other for other in uncounted if self._found[other] == self._counted[part]), None)
            if match is not None:
                uncounted.remove(match)
                self._counted[match] = self._counted.pop(part)

    def _note(self, part: int) -> None:
        found = self._found[part]
        said = [counts[part] for counts in (self._counted, self._listed) if part in counts]
        expected = found if found in said else next(iter(said), None)  # one of the two may be damaged
        missing = None if expected is None or expected < found else expected - found
        is_counted = len(self._counted) == self._chunk_count  # else counts are lost, too
        if is_counted and self._found.total() == sum(self._counted.values()):
            missing = 0
        if gaps := self._gaps.get(part):
            position, _, reason = gaps[0]
            more = f" (and in {len(gaps) - 1} more places of the chunk)" if len(gaps) > 1 else ""
            if reason == CUT_INDEX:
                missing = 0
            self._losses.note(position, reason + more, size=sum(size for _, size, _ in gaps), messages=missing)
        elif missing:
            reason = f"the index lists {expected} messages in this chunk, found {found}"
            self._losses.note(part, reason, messages=missing)

    def _read(self, position: int) -> Record | None:
        return read_record(self._stream, position, self._end)

    def _skip(self, position: int, search_from: int, reason: str = "") -> int:
        """Skip the damage at `position`; returns where the next record begins."""
        following = find_record(self._stream, search_from, self._end)
        size = following - position
        if self._base is None:
            self._part = position
        if not reason:
            reason = "no record begins here: the bytes were overwritten"
            if following == self._end:
                reason = CUT_INDEX if self._in_index else "the file ends in the middle of a record: it was cut off"
                if not self._in_index:
                    size = max(size, self._index_position - position)
        self._gaps[self._part].append((position, size, reason))
        return following

    def _take_chunk(self, record: Record) -> int:
        """Begin a chunk; returns where the next record begins: inside the chunk if it is not compressed."""
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
        with self._losses.guard() as damage:
            unpacked = unpack(
                self._stream,
                record.data,
                limit,
                compression,
                largest=self._limits.max_chunk_bytes,
                allowance=self._allowance,
            )
            if not reaches_end:
                check_complete(unpacked, compression)
        if damage.error:
            reason = f"a chunk that does not unpack ({damage.reason})"
            if bounded:
                self._gaps[record.start].append((record.start, record.end - record.start, reason))
                return record.end
            return self._skip(record.start, record.data, reason)
        self._chunks[record.start] = Chunk(record.data, unpacked.packed_size, compression, not unpacked.complete)
        used = self._take_unpacked(unpacked.data, record.start)
        if not unpacked.complete:
            reason = f"the file ends in the middle of a chunk: it was cut off ({used} bytes of it could be unpacked)"
            size = max(self._end, self._index_position) - record.start
            self._gaps[record.start].append((record.start, size, reason))
        return record.end if bounded else record.data + unpacked.packed_size

    def _take_unpacked(self, data: bytes, chunk: int) -> int:
        """Take the records of an unpacked chunk; returns how many bytes they take up."""
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
        """Take a message that is not compressed."""
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
        with self._losses.guard():  # each is recorded twice; if both are lost, its messages are counted
            id_ = record.number(b"conn")
            known = self._connections.get(id_)
            if known is not None and is_same(known, stream, record):
                return
            connection = connection_of(stream, record)
            known = self._connections.setdefault(id_, connection)
            places = {"known_at": "in the chunk", "other_at": "in another chunk or at the end of the file"}
            position = record.start if stream is self._stream else self._part
            self._connections[id_] = agreed(known, connection, self._losses, id_=id_, position=position, **places)

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
            self._chunk_count = record.number(b"chunk_count") if b"chunk_count" in record.fields else 0
