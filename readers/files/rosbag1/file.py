"""ROS 1 bags, format 2.0 (http://wiki.ros.org/Bags/Format/2.0), with uncompressed, bz2 or lz4 chunks.

The index has no checksum. It is compared with itself when the file is opened, and each chunk with it when its first
message is due. rosbags' own reader believes it: a changed bit in the number of chunks hides the others, one in a record
at the end of the file renames a topic. It also leaves messages of equal time in the order of their connections.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from heapq import heappop, heappush
from itertools import pairwise
from pathlib import Path

import numpy as np

from pipeline.core.arrays import I64
from pipeline.core.errors import RecordingError
from pipeline.core.messages import RawMessage
from readers.files.container import Container, Source
from readers.files.passes import pass_starts
from readers.files.rosbag1.chunk import Entry, Found
from readers.files.rosbag1.chunk_reader import ChunkReader
from readers.files.rosbag1.index import Contents, contents_of_index
from readers.files.rosbag1.recovery import contents_of_scan
from readers.files.rows import RowsByKey, counts_of, in_order
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import RosVersion, TopicInfo, merge_topics

__all__ = ["Rosbag1File"]

LATE = "a message before the time that its index names, found too late to be read in its place"

_FilePlace = tuple[int, int]
"""Position of a chunk, and offset in it."""

_FIRST, _LAST = (-1, 0), (2**62, 0)


class Rosbag1File(Container):
    """One open .bag file; see `RecordingFile`.

    Args:
        source: The file.
        content: Where its uncompressed content is.
    """

    ros_version: RosVersion = "ROS 1"

    def __init__(self, source: Source, content: Path) -> None:
        super().__init__(source, content.open("rb"))

    def _describe(self) -> None:
        contents, is_indexed = self._read_contents()
        self._index = contents.index
        self._chunks = ChunkReader(self._stream, contents, self._limits, self._losses)
        connections = self._chunks.confirm_connections() if is_indexed else contents.connections
        self._channels = {id_: connection.channel for id_, connection in connections.items()}
        self._rows = RowsByKey(self._index[:, 3])
        self._pass_places = _pass_places(self._index)
        counts = counts_of(self._index[:, 3])
        self.topics = merge_topics(
            TopicInfo(channel.topic, channel.msgtype, counts[id_], (channel,))
            for id_, channel in self._channels.items()
        )
        self.message_count = len(self._index)
        self.start_ns, self.end_ns = (int(self._index[i, 0]) if self.message_count else 0 for i in (0, -1))

    def _read_contents(self) -> tuple[Contents, bool]:
        """What the index says, or what a scan finds if there is no valid one; and whether it is the index."""
        indexed: Contents | None = None
        with self._losses.guard() as damage:
            indexed = contents_of_index(self._stream)
        if indexed is not None and self._source.options.recovery != "full_scan":
            return indexed, True
        scanned = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
        if damage.error and not len(scanned.index):
            raise damage.error
        if indexed is not None and not self.losses and _messages(indexed) != _messages(scanned):
            reason = "its index does not agree with the messages in the chunks, which are used"
            self._losses.note(0, reason, messages=max(len(indexed.index) - len(scanned.index), 0))
        return (scanned, False) if indexed is None or len(scanned.index) else (indexed, True)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = {id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics}
        start = 0 if start_ns is None else start_ns
        stop = 2**63 if stop_ns is None else stop_ns
        for begin, end in pairwise([_FIRST, *self._pass_places, _LAST]):
            yield from self._messages_of(wanted, start, stop, begin, end)

    def _messages_of(
        self, wanted: set[int], start_ns: int, stop_ns: int, begin: _FilePlace, end: _FilePlace
    ) -> Iterator[RawMessage]:
        """Those of one pass of the recorder's clock, which lies between two places of the file."""
        self._chunks.begin()
        waiting: list[tuple[int, int, int, Found]] = []
        left: Counter[int] = Counter()  # messages still to be yielded, by chunk
        last_ns = 0
        for position, entries in self._by_chunk(wanted, start_ns, stop_ns, begin, end):

            def is_taken(entry: Entry, position: int = position) -> bool:
                is_between = begin <= (position, entry.offset) < end
                return is_between and entry.connection_id in wanted and start_ns <= entry.log_time_ns < stop_ns

            first = entries[0].log_time_ns, position, entries[0].offset
            while waiting and waiting[0] < first:
                last_ns = waiting[0][0]
                if message := self._read(heappop(waiting), left):
                    yield message
            self._check_open()
            for found in self._chunks.due(position, entries, is_taken):
                log_time_ns, offset, _ = found.entry
                if log_time_ns < last_ns:
                    self._chunks.note_message(position, offset, LATE)
                    continue
                heappush(waiting, (log_time_ns, position, offset, found))
                left[position] += 1
            if 2 * len(waiting) > self._limits.max_positions_waiting:  # each takes twice as much as one of MCAP
                raise RecordingError(
                    f"{self.path}: more than {self._limits.max_positions_waiting // 2} messages of chunks that overlap "
                    "in time: rewrite it in the order of time, or raise limits.max_positions_waiting"
                )
        while waiting:
            if message := self._read(heappop(waiting), left):
                yield message

    def _by_chunk(
        self, wanted: set[int], start_ns: int, stop_ns: int, begin: _FilePlace, end: _FilePlace
    ) -> Iterator[tuple[int, list[Entry]]]:
        """The wanted entries of the index by chunk, in the order of the first one of each."""
        span = np.searchsorted(self._index[:, 0], (start_ns, min(stop_ns, 2**63 - 1)))
        if len(wanted) < len(self._channels):
            index = self._index[self._rows.of(wanted, span)]
        else:
            index = self._index[slice(*span.tolist())]
        if self._pass_places:
            chunks, offsets = index[:, 1], index[:, 2]
            is_behind = (chunks > begin[0]) | ((chunks == begin[0]) & (offsets >= begin[1]))
            index = index[is_behind & ((chunks < end[0]) | ((chunks == end[0]) & (offsets < end[1])))]
        by_chunk = None if in_order(index, (1,)) else np.argsort(index[:, 1], kind="stable")
        sorted_positions = index[:, 1] if by_chunk is None else index[by_chunk, 1]
        starts = np.r_[0, np.flatnonzero(sorted_positions[1:] != sorted_positions[:-1]) + 1][: len(index)]
        positions, ends = sorted_positions[starts].tolist(), [*starts[1:].tolist(), len(index)]
        del sorted_positions
        for number in np.argsort(starts if by_chunk is None else by_chunk[starts]).tolist():
            part = slice(int(starts[number]), ends[number])
            rows = index[part] if by_chunk is None else index[by_chunk[part]]
            yield positions[number], list(map(Entry._make, rows[:, (0, 2, 3)].tolist()))

    def _read(self, due: tuple[int, int, int, Found], left: Counter[int]) -> RawMessage | None:
        """A message; None if it is damaged, which is noted."""
        log_time_ns, position, offset, message = due
        channel = self._channels[message.entry.connection_id]
        self._check_open()
        data = self._chunks.read(position, message)
        left[position] -= 1
        if not left[position]:
            del left[position]
            self._chunks.drop(position)
        if data is None:
            return None
        order = self._source.index, (position << 32) + offset  # offsets are uint32
        return RawMessage(stamp_or_log_time(channel, data, log_time_ns), log_time_ns, order, data, channel)


def _messages(contents: Contents) -> bytes:
    """Log time, chunk and connection of all messages, to be compared: some writers index other offsets."""
    table = contents.index[:, (0, 1, 3)]
    return table[np.lexsort(table.T)].tobytes()


def _pass_places(index: I64) -> list[_FilePlace]:
    """Where the second and later passes of the recorder's clock begin; mostly none."""
    if in_order(index, (1, 2)):  # log times rise through the file
        return []
    in_file = np.lexsort((index[:, 2], index[:, 1]))
    starts = pass_starts(index[in_file, 0], index[in_file, 3])
    return [(int(index[in_file[start], 1]), int(index[in_file[start], 2])) for start in starts]
