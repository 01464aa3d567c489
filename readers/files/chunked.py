"""Files whose messages lie in chunks (MCAP, ROS 1 bags): messages in the order of time, one chunk after the other.

An index, or a scan, says which chunks there are, what times they span and how many messages they hold. A chunk that
holds another number when it is read is noted; its own messages are used.
"""

import heapq
from abc import abstractmethod
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.errors import RecordingError, is_short_memory
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.files.container import Container, read_exactly
from lidcam.readers.files.damage import LIBRARY_ERRORS
from lidcam.readers.files.decompress import check_file_size, decompressed
from lidcam.readers.files.passes import MIN_JUMP_NS, pass_starts
from lidcam.readers.location import RemotePath
from lidcam.readers.messages.header_stamp import stamp_or_log_time

CACHE_BYTES = 64 << 20

FilePlace = tuple[int, int]
"""Byte of the chunk, or of the message outside of chunks; then the byte within the chunk."""


class Entry(NamedTuple):
    """Place of the data of a message: sorts by time, then position; `chunk` is 0 outside of chunks."""

    log_time_ns: int
    chunk: int
    offset: int
    size: int
    channel_id: int


class ChunkPlace(NamedTuple):
    """A chunk before it is read; sorts among entries by the time of its first message."""

    start_ns: int  # Log time of its first message
    position: int  # Its first byte in the file
    end_ns: int  # Log time of its last message (inclusive)
    channel_ids: frozenset[int]  # Channels in it; empty if unknown
    size: int  # Its size in the file, in bytes
    messages: int | None = None  # Number of messages in it; None if unknown


class ChunkedFile(Container):
    """One open file; see `RecordingFile`. A subclass calls `_set_contents`, and reads the chunks."""

    def _set_contents(
        self,
        chunks: list[ChunkPlace],
        loose: list[Entry],
        channels: dict[int, Channel],
        known_ids: Collection[int] | None,
    ) -> None:
        """Set the chunks, the messages outside of them, and the channels that can be read, by id.

        `known_ids` are those of all channels; None after a scan, which has noted others.
        """
        self._chunks, self._loose, self._channels = chunks, loose, channels
        self._known_ids = known_ids
        self._bad_chunks: set[int] = set()
        self._last_read: tuple[int, list[Entry]] = (-1, [])  # the first chunk is asked for each topic's first message
        self._cache = ChunkCache()
        self._unpacked = 0  # bytes in this reading
        self._pass_places = self._find_passes()

    @abstractmethod
    def _load(self, position: int) -> bytes:
        """The records of the chunk at `position`, unpacked."""

    @abstractmethod
    def _entries_in(self, position: int, records: bytes) -> list[Entry]:
        """The messages of a chunk by its own records."""

    @abstractmethod
    def _indexed(self, place: ChunkPlace) -> I64:
        """(N, 4) places (two columns), log times and channels of a chunk's messages, if possible from an index."""

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = {id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics}
        self._unpacked = 0
        start, stop = start_ns or 0, 2**64 if stop_ns is None else stop_ns
        for begin, end in pairwise([(-1, 0), *self._pass_places, (2**64, 0)]):
            yield from self._messages_of(wanted, start, stop, begin, end)

    def _messages_of(
        self, wanted: set[int], start_ns: int, stop_ns: int, begin: FilePlace, end: FilePlace
    ) -> Iterator[RawMessage]:
        """Messages of one pass of the recorder's clock, which lies between two places of the file."""

        def is_taken(entry: Entry) -> bool:
            if entry.channel_id not in wanted or not start_ns <= entry.log_time_ns < stop_ns:
                return False
            return begin <= ((entry.chunk, entry.offset) if entry.chunk else (entry.offset, 0)) < end

        places = [
            place
            for place in self._chunks
            if place.end_ns >= start_ns
            and place.start_ns < stop_ns
            and (not place.channel_ids or place.channel_ids & wanted)
            and begin[0] <= place.position <= end[0]
        ]
        queue: list[Entry | ChunkPlace] = [*filter(is_taken, self._loose), *places]
        heapq.heapify(queue)
        left: Counter[int] = Counter()  # messages still to be yielded, by chunk
        last_ns = 0
        while queue:
            place = heapq.heappop(queue)
            if isinstance(place, ChunkPlace):
                for entry in filter(is_taken, self._entries_of(place)):
                    if entry.log_time_ns < last_ns:
                        self._note(entry, "before the time that the index names, found too late to be read")
                        continue
                    heapq.heappush(queue, entry)
                    left[place.position] += 1
                if left.total() > self._limits.max_positions_waiting:
                    raise RecordingError(
                        f"{self.path}: more than {self._limits.max_positions_waiting} messages of chunks that overlap "
                        "in time: rewrite it in the order of time, or raise limit_scale"
                    )
                continue
            last_ns = place.log_time_ns
            data = self._read_or_note(place)
            left[place.chunk] -= 1
            if not left[place.chunk]:
                del left[place.chunk]
                self._cache.drop(place.chunk)
            if data is not None:
                channel = self._channels[place.channel_id]
                order = self._source.index, (place.chunk << 32) + place.offset
                yield RawMessage(stamp_or_log_time(channel, data, last_ns), last_ns, order, data, channel)

    def _entries_of(self, place: ChunkPlace) -> list[Entry]:
        """The messages of a chunk; none if it is damaged, which is noted."""
        position, count = place.position, place.messages
        if position in self._bad_chunks:
            return []
        if position == self._last_read[0]:
            return self._last_read[1]
        with self._losses.guard() as damage:
            entries = self._entries_in(position, self._records_of(position))
            if count is not None and count != len(entries):
                reason = f"the index lists {count} messages in this chunk, found {len(entries)}"
                self._losses.note(position, reason, messages=max(count - len(entries), 0))
            known = self._known_ids
            if known is not None and (unknown := sum(entry.channel_id not in known for entry in entries)):
                self._losses.note(position, "messages of channels that the file does not name", messages=unknown)
            self._last_read = position, entries
            return entries
        self._bad_chunks.add(position)
        self._losses.note(position, f"a chunk that cannot be read ({damage.reason})", size=place.size, messages=count)
        return []

    def _read_or_note(self, entry: Entry) -> bytes | memoryview | None:
        """The data of a message; None if they are damaged, which is noted."""
        try:
            return self._read(entry)
        except LIBRARY_ERRORS as err:
            self._note(entry, self._losses.reason(err))
            return None

    def _note(self, entry: Entry, reason: str) -> None:
        where = f"a message at byte {entry.offset} of the chunk: " if entry.chunk else ""
        self._losses.note(entry.chunk or entry.offset, where + reason, messages=1)

    def _read(self, entry: Entry) -> bytes | memoryview:
        self._check_open()
        if entry.size > self._limits.max_message_bytes:
            raise ValueError(f"a message of {entry.size} bytes, see limit_scale")
        data: bytes | memoryview
        if entry.chunk:
            data = detach(self._records_of(entry.chunk), entry.offset, entry.size)
        else:
            self._stream.seek(entry.offset)
            data = read_exactly(self._stream, entry.size)
        return decompressed(
            data,
            self._channels[entry.channel_id].encoding,
            announced=self._source.metadata.message_compression,
            largest=self._limits.max_message_bytes,
        )

    def _records_of(self, position: int) -> bytes:
        self._check_open()
        return self._cache.get(position, lambda: self._counted(position))

    def _counted(self, position: int) -> bytes:
        records = self._load(position)
        self._unpacked += len(records)
        check_file_size(self.path, self._unpacked, self._stream.seek(0, 2), self._limits)
        return records

    def _find_passes(self) -> list[FilePlace]:
        """The first place of each pass of the recorder's clock but the first; mostly none.

        None are found where the indexes of messages are damaged, and on a server.
        """
        if isinstance(self.path, RemotePath):
            return []
        try:
            if not self._may_jump():
                return []
            places = [(entry.offset, 0, entry.log_time_ns, entry.channel_id) for entry in self._loose]
            loose = np.array(places, np.int64).reshape(-1, 4)
            table = np.concatenate([loose, *map(self._indexed, self._chunks)])
        except LIBRARY_ERRORS as err:
            if is_short_memory(err):
                raise
            return []
        table = table[np.lexsort((table[:, 1], table[:, 0]))]
        return [(int(table[row, 0]), int(table[row, 1])) for row in pass_starts(table[:, 2], table[:, 3])]

    def _may_jump(self) -> bool:
        """Whether something lies in the file behind later log times, by the times of the chunks, or in the last one."""
        spans = [(place.position, place.start_ns, place.end_ns) for place in self._chunks if place.end_ns]
        spans += [(entry.offset, entry.log_time_ns, entry.log_time_ns) for entry in self._loose]
        latest_ns = 0
        for _, start_ns, end_ns in sorted(spans):
            if start_ns < latest_ns - MIN_JUMP_NS:
                return True
            latest_ns = max(latest_ns, end_ns)
        last = max(self._chunks, key=lambda place: place.position, default=None)
        if last is None or last.end_ns - last.start_ns <= MIN_JUMP_NS:
            return False
        rows = self._indexed(last)
        log_times_ns = rows[np.argsort(rows[:, 1]), 2]
        return bool(len(rows)) and bool((np.maximum.accumulate(log_times_ns) - log_times_ns).max() > MIN_JUMP_NS)


class ChunkCache:
    """The most recently used chunks, up to `CACHE_BYTES` (at least one chunk).

    Messages are read in time order but chunks are in the order of writing, so chunks that overlap in time are read
    alternately. The bound keeps memory constant even if all chunks of a recording overlap.
    """

    def __init__(self) -> None:
        self._bytes = 0
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def get(self, position: int, load: Callable[[], bytes]) -> bytes:
        """The chunk at `position` of the file; `load` is called if it is not in the cache."""
        if position in self._chunks:
            self._chunks.move_to_end(position)
            return self._chunks[position]
        chunk = load()
        self._chunks[position] = chunk
        self._bytes += len(chunk)
        while self._bytes > CACHE_BYTES and len(self._chunks) > 1:
            self._bytes -= len(self._chunks.popitem(last=False)[1])
        return chunk

    def drop(self, position: int) -> None:
        """Remove the chunk at `position`, because its last message was read."""
        self._bytes -= len(self._chunks.pop(position, b""))


def detach(chunk: bytes, start: int, size: int) -> bytes | memoryview:
    """The message at `start` of a chunk: a view if it is nearly all of the chunk, which the view keeps, else a copy."""
    if size < 0 or start + size > len(chunk):
        raise ValueError(f"a message of {size} bytes at {start} reaches beyond its chunk of {len(chunk)}")
    if size * 8 < len(chunk) * 7:
        return chunk[start : start + size]
    return memoryview(chunk)[start : start + size]
