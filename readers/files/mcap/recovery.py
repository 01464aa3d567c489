"""What a damaged MCAP file still holds: by a walk over its records that goes on behind what cannot be read."""

import re
import struct
from collections import Counter
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics

from pipeline.core.settings.recording import LimitsConfig
from readers.files.damage import Losses, describe, is_damage
from readers.files.decompress import Allowance
from readers.files.mcap.index import (
    CHUNK_HEAD,
    MAGIC_BYTES,
    MESSAGE_HEAD,
    RECORD_HEAD,
    UINT64,
    ChunkPlace,
    Contents,
    add_loose,
    count_entry,
    entry_of,
    has_sound_summary,
    load_chunk,
    read_chunk_head,
    read_exactly,
    records_in,
    register,
)

__all__ = ["chunk_extent", "contents_of_walk"]

INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of the entries
INDEX_ENTRY_BYTES = 16

LEAST_BYTES = {
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: MESSAGE_HEAD.size,
    Opcode.CHUNK: CHUNK_HEAD.size + UINT64.size,
    Opcode.MESSAGE_INDEX: INDEX_HEAD.size,
    Opcode.STATISTICS: 46,
    Opcode.DATA_END: 4,
}
MAX_BYTES = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}

OPCODES = range(Opcode.HEADER, Opcode.DATA_END + 1)

# A kind of record, and a length below 2^40.
RECORD_START = re.compile(rb"(?s)(?=[\x01-\x0f].{5}\x00{3}).")
SEARCH_BLOCK = 1 << 20


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


def contents_of_walk(stream: BinaryIO, losses: Losses, *, because: str, limits: LimitsConfig) -> Contents:
    """Read the whole file once, holding one chunk at a time; what cannot be read is noted.

    Args:
        stream: The file.
        losses: Gets what is damaged.
        because: Why the file's summary was not used; noted where nothing else is found to be wrong.
        limits: How much it may unpack to.

    Raises:
        RecordingError: it has more messages outside of chunks than may be held in memory.
    """
    walk = _Walk(stream, _end_of_records(stream), losses, limits)
    walk.run()
    walk.close(because)
    return walk.contents


def _indexed_messages(stream: BinaryIO, chunk_end: int) -> int | None:
    """Number of messages in the chunk that ends at `chunk_end`, by the indexes behind it; None without any."""
    count = None
    end = _end_of_records(stream)
    record = _record_at(stream, chunk_end, end)
    while record is not None and record.opcode == Opcode.MESSAGE_INDEX:
        count = (count or 0) + _listed(record)
        record = _record_at(stream, record.end, end)
    return count


def chunk_extent(stream: BinaryIO, position: int) -> tuple[int | None, int | None]:
    """Size in the file and number of messages of the damaged chunk at `position`; None what cannot be told."""
    record = _record_at(stream, position, _end_of_records(stream))
    if record is None or record.opcode != Opcode.CHUNK:
        return None, None
    return record.end - position, _indexed_messages(stream, record.end)


def _listed(index: Record) -> int:
    return (index.size - INDEX_HEAD.size) // INDEX_ENTRY_BYTES


def _end_of_records(stream: BinaryIO) -> int:
    size = stream.seek(0, 2)
    stream.seek(0)
    magic = stream.read(MAGIC_BYTES)
    stream.seek(max(size - MAGIC_BYTES, 0))
    return size - MAGIC_BYTES if size > MAGIC_BYTES and stream.read() == magic else size


def _record_at(stream: BinaryIO, position: int, end: int) -> Record | None:
    """The record at `position`; None where there is none that is whole."""
    if position + RECORD_HEAD.size > end:
        return None
    stream.seek(position)
    opcode, size = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    record = Record(opcode, position, position + RECORD_HEAD.size, size)
    if opcode not in OPCODES or record.end > end:
        return None
    if not LEAST_BYTES.get(opcode, 0) <= size <= MAX_BYTES.get(opcode, size):
        return None
    if opcode == Opcode.MESSAGE_INDEX:
        _, listed = INDEX_HEAD.unpack(stream.read(INDEX_HEAD.size))
        return record if size == listed + INDEX_HEAD.size and not listed % INDEX_ENTRY_BYTES else None
    if opcode == Opcode.CHUNK and not _is_chunk(stream, record):
        return None
    return record


def _is_chunk(stream: BinaryIO, record: Record) -> bool:
    """Whether the two lengths that a chunk has agree."""
    try:
        head = read_chunk_head(stream)
    except (EOFError, ValueError):
        return False
    return head.position + head.size == record.end


def _find_record(stream: BinaryIO, position: int, end: int) -> int:
    """Where the next records begin at or after `position`; `end` where none do."""
    while position < end:
        stream.seek(position)
        block = stream.read(min(SEARCH_BLOCK, end - position))
        for match in RECORD_START.finditer(block):
            if _begins(stream, position + match.start(), end):
                return position + match.start()
        if position + len(block) >= end:
            return end
        position += len(block) - RECORD_HEAD.size
    return end


def _begins(stream: BinaryIO, position: int, end: int) -> bool:
    """Whether a chunk, or a row of three records, is at `position`."""
    for _ in range(3):
        record = _record_at(stream, position, end)
        if record is None:
            return False
        if record.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX} or record.end == end:
            return True
        position = record.end
    return True


class _Walk:
    """Goes from record to record, and where there is none from the damage to the next one."""

    def __init__(self, stream: BinaryIO, end: int, losses: Losses, limits: LimitsConfig) -> None:
        self.contents = Contents()
        self._stream = stream
        self._end = end
        self._losses = losses
        self._limits = limits
        self._allowance = Allowance(limits.max_unpacked_bytes(end))
        self._listed: Counter[int] = Counter()  # messages by chunk, by the indexes behind each
        self._bad: dict[int, tuple[str, int]] = {}  # reason and size by position
        self._part: int | None = None  # the chunk before
        self._total: int | None = None
        self._doubtful = Contents()  # schemas and channels of chunks whose checksum is wrong
        self._data_end: int | None = None  # position of the record that ends the data

    def run(self) -> None:
        """Go from the begin of the file to its end."""
        position = MAGIC_BYTES
        record = self._read(position)
        while position < self._end:
            if record is None:
                position = self._skip(position)
                record = self._read(position)
                continue
            following = self._read(record.end)
            if record.opcode == Opcode.MESSAGE and following is None and not self._looks_like_record(record.end):
                # What follows is no record: the damage began in this message, or its length is wrong.
                position = self._skip(position, record.content)
                record = self._read(position)
                continue
            self._take(record)
            position, record = record.end, following

    def close(self, because: str) -> None:
        """Note what was lost, and leave out messages whose channel is not known."""
        contents = self.contents
        self._use_doubtful()
        unlisted = {id_: count for id_, count in contents.counts.items() if not self._is_known(id_)}
        for id_ in unlisted:
            del contents.counts[id_]
            contents.channels.pop(id_, None)
        missing = None if self._total is None else self._total - contents.counts.total() - sum(unlisted.values())
        lost = {position: self._messages_lost(position) for position in self._bad}
        unknown = [position for position, count in lost.items() if count is None]
        if missing is not None:
            missing = max(missing - sum(count or 0 for count in lost.values()), 0)
            if len(unknown) == 1:
                lost[unknown[0]], missing = missing, 0
        for position, (reason, size) in self._bad.items():
            self._losses.note(position, reason, size=size, messages=lost[position])
        if unlisted:
            reason = "messages of channels whose record was lost: their topic and type are unknown"
            self._losses.note(0, reason, messages=sum(unlisted.values()))
        if missing and not unknown:
            reason = f"its statistics say {self._total} messages, {missing} of them were not found"
            self._losses.note(self._end, reason, messages=missing)
        elif because and not self._losses.listed():
            reason = f"its summary cannot be used ({because}); the messages were found by reading the whole file"
            self._losses.note(self._end, reason, messages=0)

    def _messages_lost(self, position: int) -> int | None:
        """Messages lost by the damage at `position`; None if nothing tells."""
        if self._data_end is not None and position >= self._data_end:
            return 0
        return self._listed.get(position)

    def _use_doubtful(self) -> None:
        """Name channels that are in use and named nowhere else by the records of damaged chunks."""
        contents, names = self.contents, []
        for id_ in sorted(contents.counts):
            if not self._is_known(id_) and (channel := self._doubtful.channels.get(id_)) is not None:
                channel = contents.channels.setdefault(id_, channel)
                if (schema := self._doubtful.schemas.get(channel.schema_id)) is not None:
                    contents.schemas.setdefault(channel.schema_id, schema)
                names.append(channel.topic)
        if names:
            reason = f"name and type of {', '.join(names)} are taken from a chunk whose checksum is wrong"
            self._losses.note(min(self._bad), reason, messages=0)

    def _is_known(self, channel_id: int) -> bool:
        channel = self.contents.channels.get(channel_id)
        return channel is not None and (not channel.schema_id or channel.schema_id in self.contents.schemas)

    def _read(self, position: int) -> Record | None:
        return _record_at(self._stream, position, self._end)

    def _looks_like_record(self, position: int) -> bool:
        """Whether a record that is damaged, or cut off by the end, seems to begin at `position`."""
        if position + RECORD_HEAD.size > self._end:
            return True
        self._stream.seek(position)
        opcode, size = RECORD_HEAD.unpack(self._stream.read(RECORD_HEAD.size))
        return opcode in OPCODES or self._read(position + RECORD_HEAD.size + size) is not None

    def _skip(self, position: int, search_from: int | None = None) -> int:
        """Leave out what begins at `position`; where to go on."""
        following = _find_record(self._stream, position + 1 if search_from is None else search_from, self._end)
        self._part = position
        if following == self._end and self._take_cut_chunk(position):
            return self._end
        reason = "no record begins here: the bytes were overwritten"
        if following == self._end:
            reason = "the file ends in the middle of a record: it was cut off"
        self._bad[position] = (reason, following - position)
        return following

    def _take_cut_chunk(self, position: int) -> bool:
        """Take what is whole of a chunk inside which the file ends; False where it is none."""
        self._stream.seek(position)
        head = self._stream.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size or head[0] != Opcode.CHUNK:
            return False
        size = RECORD_HEAD.unpack(head)[1]
        try:
            inner = read_chunk_head(self._stream)
            if (
                position + RECORD_HEAD.size + size != inner.position + inner.size
                or inner.position + inner.size < self._end
            ):
                return False
            chunk = self._load(position, is_cut=True)
        except Exception as err:
            if not is_damage(err):
                raise
            return False
        self._take_records(chunk, position)
        self.contents.cut_chunk = position
        reason = f"the file ends in the middle of a chunk: it was cut off ({len(chunk)} bytes of it could be unpacked)"
        self._bad[position] = (reason, RECORD_HEAD.size + size)
        return True

    def _take(self, record: Record) -> None:
        if record.opcode == Opcode.CHUNK:
            self._part = record.start
            try:
                self._take_records(self._load(record.start), record.start)
            except Exception as err:
                if not is_damage(err):
                    raise
                self._bad[record.start] = (f"a chunk that cannot be read ({describe(err)})", record.end - record.start)
                self._take_doubtful(record.start)
        elif record.opcode == Opcode.MESSAGE:
            self._stream.seek(record.content)
            entry = entry_of(read_exactly(self._stream, MESSAGE_HEAD.size), 0, 0, record.content, record.size)
            add_loose(self.contents, entry, self._limits)
        elif record.opcode == Opcode.MESSAGE_INDEX and self._part is not None:
            self._listed[self._part] += _listed(record)
        elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            self._stream.seek(record.content)
            self._register(record.opcode, read_exactly(self._stream, record.size), record.start)
        elif record.opcode == Opcode.DATA_END:
            self._data_end = record.start
        elif record.opcode == Opcode.STATISTICS:
            self._stream.seek(record.content)
            try:
                if has_sound_summary(self._stream):
                    self._stream.seek(record.content)
                    self._total = Statistics.read(ReadDataStream(self._stream)).message_count
            except Exception as err:
                if not is_damage(err):
                    raise

    def _take_doubtful(self, position: int) -> None:
        """Keep the schemas and channels of a damaged chunk: for a file that names them nowhere else."""
        try:
            chunk = self._load(position, verify=False)
            for opcode, at, size in records_in(chunk, self._limits):
                register(self._doubtful, opcode, chunk[at : at + size])
        except Exception as err:
            if not is_damage(err):
                raise

    def _load(self, position: int, *, is_cut: bool = False, verify: bool = True) -> bytes:
        """A chunk, as long as all of them do not unpack to more than is allowed."""
        self._stream.seek(position + RECORD_HEAD.size)
        head = read_chunk_head(self._stream)
        self._allowance.take(head.uncompressed_size if head.compression else 0)
        return load_chunk(self._stream, position, self._limits, is_cut=is_cut, verify=verify)

    def _take_records(self, chunk: bytes, position: int) -> None:
        """Take all of a chunk, or nothing.

        Raises:
            ValueError: its records do not fit it.
        """
        records = list(records_in(chunk, self._limits))
        entries = [entry_of(chunk, at, position, at, size) for opcode, at, size in records if opcode == Opcode.MESSAGE]
        for opcode, at, size in records:
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._register(opcode, chunk[at : at + size], position)
        for entry in entries:
            count_entry(self.contents, entry)
        if entries:
            times = [entry.log_time_ns for entry in entries]
            ids = frozenset(entry.channel_id for entry in entries)
            self.contents.chunks.append(ChunkPlace(min(times), position, max(times), ids))

    def _register(self, opcode: int, record: bytes, position: int) -> None:
        """Take in a schema or channel; the first of each number holds, since those in chunks have a checksum."""
        contents = self.contents
        found = Contents()
        try:
            register(found, opcode, record)
        except Exception as err:
            if not is_damage(err):
                raise
            self._bad[position] = (f"a record that cannot be read ({describe(err)})", len(record))
        for id_, schema in found.schemas.items():
            contents.schemas.setdefault(id_, schema)
        for id_, channel in found.channels.items():
            contents.channels.setdefault(id_, channel)
