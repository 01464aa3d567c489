"""Contents of a ROS 1 bag, found by a scan of all its records that resumes after damage."""

from collections import Counter, defaultdict
from io import BytesIO
from typing import BinaryIO

from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.chunked import ChunkPlace
from lidcam.readers.files.damage import Losses
from lidcam.readers.files.decompress import MAGICS, check_file_size, unpack
from lidcam.readers.files.rosbag1.records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER,
    INDEX,
    MAGIC_BYTES,
    MESSAGE,
    ChunkData,
    Contents,
    Record,
    channel_of,
    contents_of_chunk,
    find_record,
    looks_like_record,
    read_record,
)

MAX_RUN_BYTES = 4 << 20
"""Messages that are not compressed are read in runs of adjacent records, of about this size at most."""

CUT_INDEX = "the index at the end of the file is cut off; the messages were found by reading the whole file"


def contents_of_scan(stream: BinaryIO, losses: Losses, *, because: str, limits: RecordingLimits) -> Contents:
    """The contents, found by reading the whole file once; one chunk at a time is in memory.

    `because` says why the index is invalid, for a file without other damage; it is empty if it may be valid.
    """
    scan = _Scan(stream, stream.seek(0, 2), losses, limits)
    scan.run()
    scan.note_losses(because)
    return scan.contents


class _Scan:
    """Reads one record after the other; after damage it searches for the next one.

    Messages that are not compressed are gathered into runs, which are read like chunks. A chunk, its damage and the
    index after it are counted under one position.
    """

    def __init__(self, stream: BinaryIO, end: int, losses: Losses, limits: RecordingLimits) -> None:
        self.contents = Contents()
        self._stream = stream
        self._losses = losses
        self._limits = limits
        self._end = end
        self._run: list[Record] = []  # adjacent messages and connections outside of compressed chunks
        self._part = 0  # position under which messages are counted
        self._found: Counter[int] = Counter()
        self._listed: Counter[int] = Counter()  # according to the index after each chunk
        self._gaps: defaultdict[int, list[tuple[int, int, str]]] = defaultdict(list)
        self._in_chunk = self._in_index = False
        self._index_position = 0
        self._unpacked = 0  # bytes of the chunks read

    def run(self) -> None:
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
                    # No record follows: the damage began in this message, or its length is wrong.
                    position = self._skip(position, record.data)
                    record = self._read(position)
                    continue
                self._add_to_run(record)
            elif record.kind == CONNECTION:
                self._in_index |= not self._in_chunk
                self._take_connection(self._stream, record)
                self._add_to_run(record)
            elif record.kind != CHUNK:
                self._take_other(record)
            position, record = following, next_record
        self._end_run()

    def note_losses(self, because: str) -> None:
        """Note what was lost, and leave out messages whose connection is unknown."""
        losses, contents = self._losses, self.contents
        unknown = [id_ for id_ in contents.counts if id_ not in contents.channels]
        if lost := sum(contents.counts.pop(id_) for id_ in unknown):
            reason = "messages of connections whose record was lost: their topic and type are unknown"
            losses.note(0, reason, messages=lost)
        for part in sorted({*self._gaps, *self._found, *self._listed}):
            self._note(part)
        if because and not losses.listed():
            if self._index_position:
                reason = f"its index cannot be used ({because}); the messages were found by reading the whole file"
                losses.note(self._index_position, reason, messages=0)
            else:
                losses.note(self._end, "it was not closed: what the recorder had not written yet is missing")

    def _note(self, part: int) -> None:
        found, listed = self._found[part], self._listed.get(part)
        missing = None if listed is None else max(listed - found, 0)
        if gaps := self._gaps.get(part):
            position, _, reason = gaps[0]
            more = f" (and in {len(gaps) - 1} more places of the chunk)" if len(gaps) > 1 else ""
            if reason == CUT_INDEX:
                missing = 0
            self._losses.note(position, reason + more, size=sum(size for _, size, _ in gaps), messages=missing)
        elif missing:
            self._losses.note(part, f"the index lists {listed} messages in this chunk, found {found}", messages=missing)

    def _read(self, position: int) -> Record | None:
        return read_record(self._stream, position, self._end)

    def _skip(self, position: int, search_from: int, reason: str = "") -> int:
        """Skip the damage at `position`; returns where the next record begins."""
        following = find_record(self._stream, search_from, self._end)
        size = following - position
        self._end_run()
        if not self._in_chunk:
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
        self._end_run()
        self._part, self._in_chunk, self._in_index = record.start, False, False
        self._stream.seek(record.data)
        begin = self._stream.read(4)
        compression = next((name for magic, name in MAGICS.items() if begin.startswith(magic)), "")
        if not compression:
            self._in_chunk = True
            return record.data
        reaches_end = not record.size or record.end >= self._end
        bounded = not reaches_end and self._read(record.end) is not None
        limit, largest = record.end if bounded else self._end, self._limits.max_chunk_bytes
        with self._losses.guard() as damage:
            unpacked = unpack(self._stream, record.data, limit, compression, largest=largest, may_be_cut=reaches_end)
            self._unpacked += len(unpacked.data)
            check_file_size(self._losses.path, self._unpacked, self._end, self._limits)
            records = contents_of_chunk(unpacked.data, self._limits)
        if damage.error:
            reason = f"a chunk that does not unpack ({damage.reason})"
            if bounded:
                self._gaps[record.start].append((record.start, record.end - record.start, reason))
                return record.end
            return self._skip(record.start, record.data, reason)
        stream, size = BytesIO(unpacked.data), len(unpacked.data)
        for inner in records:
            if inner.kind == CONNECTION:
                self._take_connection(stream, inner)
        data = ChunkData(record.data, unpacked.packed_size, size, compression, not unpacked.complete)
        self._add_place(record.start, data, [inner for inner in records if inner.kind == MESSAGE])
        if not unpacked.complete:
            reason = f"the file ends in the middle of a chunk: it was cut off ({size} bytes of it could be unpacked)"
            lost = max(self._end, self._index_position) - record.start
            self._gaps[record.start].append((record.start, lost, reason))
        return record.end if bounded else record.data + unpacked.packed_size

    def _add_to_run(self, record: Record) -> None:
        self._run.append(record)
        if record.end - self._run[0].start > MAX_RUN_BYTES:
            self._end_run()

    def _end_run(self) -> None:
        """Add the records that were read since the last damage or chunk."""
        if messages := [record for record in self._run if record.kind == MESSAGE]:
            begin, size = self._run[0].start, self._run[-1].end - self._run[0].start
            self._add_place(begin, ChunkData(begin, size, size, "none"), messages)
        self._run = []

    def _add_place(self, position: int, data: ChunkData, messages: list[Record]) -> None:
        """Add a chunk, or a run of messages that are not compressed."""
        self._found[self._part] += len(messages)
        if messages:
            times, ids = [m.time_of(b"time") for m in messages], Counter(m.number(b"conn") for m in messages)
            place = ChunkPlace(
                min(times), position, max(times), frozenset(ids), data.position + data.size - position, len(messages)
            )
            self.contents.chunks.append(place)
            self.contents.data[position] = data
            self.contents.counts += ids

    def _take_connection(self, stream: BinaryIO, record: Record) -> None:
        with self._losses.guard():  # each is recorded twice; if both are lost, its messages are counted
            id_ = record.number(b"conn")
            if id_ not in self.contents.channels:
                self.contents.channels[id_] = channel_of(stream, record)

    def _take_other(self, record: Record) -> None:
        self._end_run()
        self._in_chunk = False
        if record.kind == INDEX:
            self._listed[self._part] += record.number(b"count")
        elif record.kind == CHUNK_INFO:
            self._in_index = True
        elif record.kind == HEADER:
            self._index_position = record.number(b"index_pos")
