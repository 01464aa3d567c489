"""Contents of an MCAP file, found by a scan of all its records that resumes after damage."""

from collections import Counter
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.files.chunked import ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.damage import LIBRARY_ERRORS, Losses
from lidcam.readers.files.decompress import check_file_size
from lidcam.readers.files.mcap.records import (
    INDEX_HEAD,
    MAGIC_BYTES,
    MESSAGE_HEAD,
    OPCODES,
    PAIR_BYTES,
    RECORD_HEAD,
    Contents,
    Record,
    end_of_records,
    entry_of,
    find_record,
    is_summary_sound,
    load_chunk,
    read_chunk_head,
    record_at,
    records_in,
)


def contents_of_scan(stream: BinaryIO, losses: Losses, *, because: str, limits: RecordingLimits) -> Contents:
    """The contents, found by reading the whole file once; one chunk at a time is in memory.

    `because` says why the summary is invalid, for a file without other damage; it is empty if it may be valid.
    """
    scan = _Scan(stream, end_of_records(stream), losses, limits)
    scan.run()
    scan.note_losses(because)
    return scan.contents


class _Scan:
    """Reads one record after the other; after damage it searches for the next one."""

    def __init__(self, stream: BinaryIO, end: int, losses: Losses, limits: RecordingLimits) -> None:
        self.contents = Contents()
        self._stream = stream
        self._end = end
        self._unpacked = 0  # bytes of the chunks read
        self._losses = losses
        self._limits = limits
        self._listed: Counter[int] = Counter()  # messages by chunk, according to the indexes after each
        self._bad: dict[int, tuple[str, int]] = {}  # reason and size by position
        self._last_chunk: int | None = None
        self._total: int | None = None
        self._data_end: int | None = None  # position of the record that ends the data

    def run(self) -> None:
        position = MAGIC_BYTES
        record = self._read(position)
        while position < self._end:
            if record is None:
                position = self._skip(position, position + 1)
                record = self._read(position)
                continue
            following = self._read(record.end)
            if record.opcode == Opcode.MESSAGE and following is None and not self._looks_like_record(record.end):
                # No record follows: the damage began in this message, or its length is wrong.
                position = self._skip(position, record.content)
                record = self._read(position)
                continue
            self._take(record)
            position, record = record.end, following

    def note_losses(self, because: str) -> None:
        """Note what was lost, and leave out messages whose channel is unknown."""
        contents, found = self.contents, self.contents.counts.total()
        unknown = {id_: count for id_, count in contents.counts.items() if not self._is_known(id_)}
        for id_ in unknown:
            del contents.counts[id_]
            contents.channels.pop(id_, None)
        if unknown:
            reason = "messages of channels whose record was lost: their topic and type are unknown"
            self._losses.note(0, reason, messages=sum(unknown.values()))
        lost = {position: self._messages_lost(position) for position in self._bad}
        uncounted = [position for position, count in lost.items() if count is None]
        total = found if self._total is None else self._total
        missing = max(total - found - sum(count or 0 for count in lost.values()), 0)
        if self._total is not None and len(uncounted) == 1:
            lost[uncounted[0]], missing = missing, 0
        for position, (reason, size) in self._bad.items():
            self._losses.note(position, reason, size=size, messages=lost[position])
        if total < found or (missing and not uncounted):
            self._losses.note(self._end, f"its statistics say {total} messages, found {found}", messages=missing)
        elif because and not self._losses.listed():
            reason = f"its summary cannot be used ({because}); the messages were found by reading the whole file"
            self._losses.note(self._end, reason, messages=0)

    def _messages_lost(self, position: int) -> int | None:
        """Messages lost by the damage at `position`; None if unknown."""
        if self._data_end is not None and position >= self._data_end:
            return 0
        return self._listed.get(position)

    def _is_known(self, channel_id: int) -> bool:
        channel = self.contents.channels.get(channel_id)
        return channel is not None and (not channel.schema_id or channel.schema_id in self.contents.schemas)

    def _read(self, position: int) -> Record | None:
        return record_at(self._stream, position, self._end)

    def _looks_like_record(self, position: int) -> bool:
        """Whether a record that is damaged, or cut off by the end, seems to begin at `position`."""
        if position + RECORD_HEAD.size > self._end:
            return True
        self._stream.seek(position)
        opcode, size = RECORD_HEAD.unpack(self._stream.read(RECORD_HEAD.size))
        return opcode in OPCODES or self._read(position + RECORD_HEAD.size + size) is not None

    def _skip(self, position: int, search_from: int) -> int:
        """Skip the damage at `position`; returns where the next record begins."""
        inside = self._inside_cut_chunk(position)
        following = inside or find_record(self._stream, search_from, self._end)
        self._last_chunk = position
        reason = "no record begins here: the bytes were overwritten"
        if inside or following == self._end:
            reason = "the file ends in the middle of a record: it was cut off"
        self._bad[position] = (reason, following - position)
        return following

    def _inside_cut_chunk(self, position: int) -> int:
        """The first record of a chunk without compression that the file ends in; 0 if none begins at `position`."""
        self._stream.seek(position)
        try:
            opcode, size = RECORD_HEAD.unpack(read_exactly(self._stream, RECORD_HEAD.size))
            head = read_chunk_head(self._stream)
        except (EOFError, ValueError):
            return 0
        end = head.position + head.size
        is_cut = opcode == Opcode.CHUNK and end == position + RECORD_HEAD.size + size and end > self._end
        return head.position if is_cut and not head.compression else 0

    def _take(self, record: Record) -> None:
        opcode = record.opcode
        if opcode in {Opcode.MESSAGE, Opcode.CHUNK}:
            self._take_messages(record)
        elif opcode == Opcode.DATA_END:
            self._data_end = record.start
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self._stream.seek(record.content)
            with self._losses.guard() as damage:
                _register(self.contents, opcode, read_exactly(self._stream, record.size))
            if damage.error:
                self._bad[record.start] = (f"a record that cannot be read ({damage.reason})", record.size)
        elif opcode == Opcode.STATISTICS:
            with self._losses.guard():
                self._stream.seek(record.content)
                count = Statistics.read(ReadDataStream(self._stream)).message_count
                if is_summary_sound(self._stream):
                    self._total = count
        elif opcode == Opcode.MESSAGE_INDEX and self._last_chunk is not None:
            self._listed[self._last_chunk] += (record.size - INDEX_HEAD.size) // PAIR_BYTES

    def _take_messages(self, record: Record) -> None:
        """Take a message or a chunk, or note that it is damaged."""
        try:
            if record.opcode == Opcode.MESSAGE:
                self._take_loose(record)
            else:
                self._last_chunk = record.start
                chunk = load_chunk(self._stream, record.start, self._limits)
                self._unpacked += len(chunk)
                check_file_size(self._losses.path, self._unpacked, self._end, self._limits)
                self._take_records(chunk, record.start, record.end - record.start)
        except LIBRARY_ERRORS as err:
            reason = f"a {Opcode(record.opcode).name.lower()} that cannot be read ({self._losses.reason(err)})"
            self._bad[record.start] = (reason, record.end - record.start)

    def _take_loose(self, record: Record) -> None:
        if len(self.contents.loose) >= self._limits.max_positions_waiting:
            raise RecordingError(
                f"more than {self._limits.max_positions_waiting} messages outside of chunks: rewrite it with chunks, "
                "or raise limit_scale"
            )
        self._stream.seek(record.content)
        entry = entry_of(read_exactly(self._stream, MESSAGE_HEAD.size), 0, 0, record.content, record.size)
        self.contents.loose.append(entry)
        self._count(entry)

    def _count(self, entry: Entry) -> None:
        contents = self.contents
        contents.counts[entry.channel_id] += 1
        contents.start_ns = min(contents.start_ns, entry.log_time_ns)
        contents.end_ns = max(contents.end_ns, entry.log_time_ns)

    def _take_records(self, chunk: bytes, position: int, size: int) -> None:
        """Take all of a chunk of `size` bytes in the file, or nothing."""
        records = list(records_in(chunk, self._limits))
        entries = [entry_of(chunk, at, position, at, size) for opcode, at, size in records if opcode == Opcode.MESSAGE]
        for opcode, at, length in records:
            _register(self.contents, opcode, chunk[at : at + length])
        for entry in entries:
            self._count(entry)
        if entries:
            times = [entry.log_time_ns for entry in entries]
            ids = frozenset(entry.channel_id for entry in entries)
            self.contents.chunks.append(ChunkPlace(min(times), position, max(times), ids, size, len(entries)))


def _register(contents: Contents, opcode: int, record: bytes) -> None:
    """Add a schema or channel unless its id is known: the first ones are in chunks, which have a checksum."""
    stream = ReadDataStream(BytesIO(record))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        contents.schemas.setdefault(schema.id, schema)
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        contents.channels.setdefault(channel.id, channel)
