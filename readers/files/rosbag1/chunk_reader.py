"""The messages of a ROS 1 bag, chunk by chunk: what the index says of a chunk is compared with the chunk itself."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from io import BytesIO
from typing import BinaryIO

import numpy as np
from rosbags.rosbag1.reader import read_bytes

from pipeline.core.settings.recording import LimitsConfig
from readers.files.chunk_cache import ChunkCache, detach
from readers.files.container import MAX_BYTES_AT_OPENING
from readers.files.damage import LIBRARY_ERRORS, Losses
from readers.files.rosbag1.as_listed import Listed, as_listed
from readers.files.rosbag1.chunk import (
    Comparison,
    Entry,
    Found,
    compared,
    has_right_length,
    load_chunk,
    message_at,
    messages_of,
)
from readers.files.rosbag1.connections import Connection, agreed, connection_of, is_same
from readers.files.rosbag1.index import Chunk, Contents
from readers.files.rosbag1.records import Record
from readers.files.rows import counts_of, least_by

__all__ = ["ChunkReader"]

MANY = 32
"""Messages of an uncompressed chunk from which on it is quicker to read all of it, if it is not large."""

LARGE_BYTES = 16 << 20


class ChunkReader:
    """Reads chunks, and notes where they and the index differ: there, the chunk counts.

    Args:
        stream: The file.
        contents: What the index says, or what a scan has found.
        limits: What a chunk may unpack to.
        losses: Collects what differs.
    """

    def __init__(self, stream: BinaryIO, contents: Contents, limits: LimitsConfig, losses: Losses) -> None:
        self._stream = stream
        self._contents = contents
        self._limits = limits
        self._losses = losses
        self._bad_chunks: set[int] = set()
        self._end = stream.seek(0, 2)
        self._cache = ChunkCache(max_loaded_bytes=limits.max_unpacked_bytes(self._end))
        self._confirmed: set[int] = set()
        self._last_listed: tuple[int, Listed] | None = None  # the first chunk is asked for each topic's first message

    def begin(self) -> None:
        """Begin to read from the start once more."""
        self._cache.begin()

    def drop(self, position: int) -> None:
        """Forget the content of a chunk."""
        self._cache.drop(position)

    def confirm_connections(self) -> dict[int, Connection]:
        """The connections, compared with the first chunks in which they have messages."""
        connections = dict(self._contents.connections)
        index = self._contents.index
        begun: dict[int, list[int]] = {position: [] for position in sorted(self._contents.chunks)[:1]}
        for id_, first in sorted(least_by(index[:, 3], index[:, 1]).items()):
            begun.setdefault(first, []).append(id_)
        left = MAX_BYTES_AT_OPENING
        for position, begun_here in sorted(begun.items()):
            if begun_here and self._confirmed.issuperset(begun_here):
                continue
            left -= self._contents.chunks[position].data_size
            if left < 0:
                break
            try:
                stream, begin, end = self._opened(position)
                for record in messages_of(stream, begin, end, self._limits)[1]:
                    self._confirm(stream, record, position, connections)
            except LIBRARY_ERRORS as err:
                self._losses.reason(err)  # told when its messages are read
        return connections

    def due(self, position: int, entries: Sequence[Entry], is_taken: Callable[[Entry], bool]) -> list[Found]:
        """The messages of a chunk that are to be read.

        Args:
            position: Of the chunk.
            entries: The wanted ones of the index.
            is_taken: Whether a message is wanted.
        """
        if position in self._bad_chunks:
            return []
        chunk = self._contents.chunks[position]
        try:
            if self._contents.found_by == "scan" or chunk.compression == "none":
                comparison = self._at_once(position, entries) or self._by_entries(position, entries)
                if comparison.only_indexed and self._contents.found_by == "index":
                    stream, begin, end = self._opened(position)
                    comparison = compared(entries, messages_of(stream, begin, end, self._limits)[0])
            elif (quickly := self._at_once(position, entries)) is not None:
                comparison = quickly
            else:
                stream, begin, end = self._opened(position)
                found, records = messages_of(stream, begin, end, self._limits)
                comparison = compared(entries, found)
                self._confirm_all(stream, records, position)
        except LIBRARY_ERRORS as err:
            self._note_chunk(position, self._losses.reason(err))
            return []
        return self._settled(position, chunk, comparison, is_taken)

    def read(self, position: int, message: Found) -> bytes | memoryview | None:
        """The data of a message; None if they are damaged, which is noted."""
        if position in self._bad_chunks:
            return None
        chunk = self._contents.chunks[position]
        try:
            if chunk.compression != "none":
                return detach(self._unpacked(position), message.data_at, message.size)
            if message.size > self._limits.max_message_bytes:
                raise ValueError(f"a message of {message.size} bytes, see limits.max_message_mib")
            self._stream.seek(message.data_at)
            return read_bytes(self._stream, message.size)
        except LIBRARY_ERRORS as err:
            if chunk.compression != "none" and not self._cache.holds(position):
                self._note_chunk(position, self._losses.reason(err))
            else:
                self.note_message(position, message.entry.offset, self._losses.reason(err))
            return None

    def note_message(self, position: int, offset: int, reason: str) -> None:
        """Note a message of a chunk as lost."""
        chunk = self._contents.chunks[position]
        if chunk.compression == "none":
            self._losses.note(chunk.data_position + offset, reason, messages=1)
        else:
            self._losses.note(position, f"a message at byte {offset} of the chunk: {reason}", messages=1)

    def _at_once(self, position: int, entries: Sequence[Entry]) -> Comparison | None:
        """The same where a chunk is just what its index says; None where it is not, or where it would take longer."""
        chunk = self._contents.chunks[position]
        is_packed = chunk.compression != "none"
        if not chunk.index_size or (not is_packed and (len(entries) < MANY or chunk.data_size > LARGE_BYTES)):
            return None
        listed = self._listed(position)
        if listed is None:
            return None
        offsets = np.fromiter((entry.offset for entry in entries), np.int64, len(entries))
        places = np.searchsorted(listed.offsets, offsets)
        data_at = listed.data_at[places] + (0 if is_packed else chunk.data_position)
        found = zip(entries, offsets.tolist(), data_at.tolist(), listed.sizes[places].tolist(), strict=True)
        return Comparison([*map(Found._make, found)], [], [])

    def _listed(self, position: int) -> Listed | None:
        """The messages of a chunk, which is read; None if it is not just what its index says."""
        if self._last_listed is not None and self._last_listed[0] == position:
            return self._last_listed[1]
        chunk = self._contents.chunks[position]
        if chunk.compression != "none":
            records = self._unpacked(position)
        else:
            self._stream.seek(chunk.data_position)
            records = read_bytes(self._stream, chunk.data_size)
        rows = self._contents.rows_of(position)
        if len(rows) > self._limits.max_messages_per_chunk:
            return None
        listed = as_listed(records, rows)
        if listed is not None:
            if chunk.compression != "none":
                self._confirm_all(BytesIO(records), listed.connections, position)
            self._last_listed = position, listed
        return listed

    def _by_entries(self, position: int, entries: Sequence[Entry]) -> Comparison:
        """The messages that the index names in a chunk, or a scan has found: nothing else of it is read."""
        stream, begin, end = self._opened(position)
        places = (message_at(stream, begin + entry.offset, begin, end) for entry in entries)
        found = [message for message in places if message is not None]
        if self._contents.found_by == "index":
            found = [message for message in found if has_right_length(stream, message, end)]
        return compared(entries, found)

    def _settled(
        self, position: int, chunk: Chunk, comparison: Comparison, is_taken: Callable[[Entry], bool]
    ) -> list[Found]:
        """What is right where chunk and index differ."""
        if not comparison.only_indexed and not any(is_taken(message.entry) for message in comparison.unlisted):
            return comparison.agreed
        indexed = {entry.offset: entry for entry in comparison.only_indexed}
        right, lost = list(comparison.agreed), dict(indexed)
        for message in comparison.unlisted:
            own = message.entry
            if own.connection_id in self._contents.connections and chunk.start_ns <= own.log_time_ns <= chunk.end_ns:
                pass
            elif own.offset in indexed:
                message = message._replace(entry=indexed[own.offset])
            else:
                continue
            if is_taken(message.entry):
                right.append(message)
                lost.pop(own.offset, None)
        spare = len(right) - len(comparison.agreed) - (len(indexed) - len(lost))  # found at other places
        for offset in sorted(lost)[spare if spare > 0 else 0 :]:
            self.note_message(position, offset, "the index names a message here, the chunk has none")
        if len(right) > len(comparison.agreed):
            reason = "the index of this chunk does not agree with the messages in it, which are used"
            self._losses.note(position, reason, messages=0)
        return right

    def _confirm_all(self, stream: BinaryIO, records: Sequence[Record], position: int) -> None:
        connections = dict(self._contents.connections)  # too late to use the other record
        for record in records:
            self._confirm(stream, record, position, connections)

    def _confirm(self, stream: BinaryIO, record: Record, position: int, connections: dict[int, Connection]) -> None:
        """Compare a connection's record in a chunk with the one at the end of the file, once."""
        id_ = record.number(b"conn")
        if id_ in self._confirmed or id_ not in connections:
            return
        self._confirmed.add(id_)
        if is_same(connections[id_], stream, record):
            return
        places = {"known_at": "at the end of the file", "other_at": "in the chunk"}
        other = connection_of(stream, record)
        connections[id_] = agreed(connections[id_], other, self._losses, id_=id_, position=position, **places)

    def _opened(self, position: int) -> tuple[BinaryIO, int, int]:
        """The records of a chunk: a stream, and where in it they begin and end."""
        chunk = self._contents.chunks[position]
        if chunk.compression == "none":
            end = chunk.data_position + chunk.data_size if chunk.data_size else self._end
            return self._stream, chunk.data_position, end
        records = self._unpacked(position)
        return BytesIO(records), 0, len(records)  # shares the bytes

    def _unpacked(self, position: int) -> bytes:
        chunk = self._contents.chunks[position]
        return self._cache.get(position, lambda: load_chunk(self._stream, position, chunk, self._limits))

    def _note_chunk(self, position: int, reason: str) -> None:
        chunk = self._contents.chunks[position]
        self._bad_chunks.add(position)
        size = chunk.data_position + chunk.data_size - position
        count = self._counts[position]
        self._losses.note(position, f"a chunk that does not unpack ({reason})", size=size, messages=count)

    @cached_property
    def _counts(self) -> Counter[int]:
        """Number of messages by chunk position."""
        return counts_of(self._contents.index[:, 1])
