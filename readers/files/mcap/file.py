"""MCAP recordings (https://mcap.dev/spec), ROS 2 (cdr) and ROS 1, with chunks (uncompressed, lz4 or zstd) or without.

The mcap library parses the summary. Messages are ordered here: the library's own queue holds every message of all
chunks that overlap in time, and it reads a file without chunk index into memory as a whole.
"""

import heapq
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from itertools import pairwise

import numpy as np
from mcap.opcode import Opcode

from pipeline.core.errors import RecordingError, is_short_memory
from pipeline.core.messages import Channel, RawMessage
from readers.files.chunk_cache import ChunkCache, detach
from readers.files.container import Container
from readers.files.damage import LIBRARY_ERRORS
from readers.files.decompress import decompressed
from readers.files.mcap.as_listed import Listed, as_listed
from readers.files.mcap.channels import channel_of, message_type
from readers.files.mcap.chunk import Entry, entry_of, load_chunk, read_exactly, records_in
from readers.files.mcap.definitions import Definitions
from readers.files.mcap.index import ChunkPlace, Contents, contents_of_summary, read_profile
from readers.files.mcap.passes import FilePlace, indexed_messages, pass_places
from readers.files.mcap.recovery import chunk_extent, contents_of_scan
from readers.files.mcap.unchecked import agrees_with_index, check_places, confirm_definitions
from readers.files.remote import ReadAhead, tell_full_read
from readers.location import RemotePath
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import RosVersion, TopicInfo, merge_topics

__all__ = ["McapFile"]

OUTSIDE_OF_CHUNKS = {*Opcode} - {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
"""What a chunk may not hold (mcap.dev/spec). Opcodes that nobody knows yet are skipped, as the specification says."""


class McapFile(Container):
    """One open MCAP file; see `RecordingFile`."""

    ros_version: RosVersion

    def _describe(self) -> None:
        self._bad_chunks: set[int] = set()
        self._chunk_cache = ChunkCache(max_loaded_bytes=self._limits.max_unpacked_bytes(self._stream.seek(0, 2)))
        self._definitions = Definitions(self._losses)
        profile, contents = self._read_contents()
        self._chunks, self._loose, self._cut_chunk = contents.chunks, contents.loose, contents.cut_chunk
        self._pass_places = self._read_passes()
        self._positions = np.sort(np.array([chunk.position for chunk in self._chunks], np.uint64))
        self._channels: dict[int, Channel] = {}
        topics = []
        for id_, recorded in sorted(contents.channels.items()):
            schema = contents.schemas.get(recorded.schema_id)
            channel = channel_of(recorded, schema, self._source.metadata.distro)
            count = contents.counts[id_]
            if isinstance(channel, str):
                topics.append(TopicInfo(recorded.topic, message_type(schema), count, (), channel))
                continue
            self._channels[id_] = channel
            topics.append(TopicInfo(recorded.topic, channel.msgtype, count, (channel,)))
        self.topics = merge_topics(topics)
        self.message_count = contents.counts.total()
        self.start_ns, self.end_ns = (contents.start_ns, contents.end_ns) if self.message_count else (0, 0)
        encodings = {channel.encoding for channel in self._channels.values()}
        self.ros_version = "ROS 1" if profile == "ros1" or encodings == {"ros1"} else "ROS 2"

    def _read_passes(self) -> list[FilePlace]:
        """Where log times jump back; none where the indexes of messages are damaged, or on a server."""
        if isinstance(self.path, RemotePath):
            return []
        try:
            return pass_places(self._stream, self._chunks, self._loose)
        except LIBRARY_ERRORS as err:
            if is_short_memory(err):
                raise
            return []

    def _read_contents(self) -> tuple[str, Contents]:
        """Profile and contents: from header and summary, or by a scan if these do not suffice."""
        profile, summary = "", None
        with self._losses.guard() as damage:
            profile = read_profile(self._stream)
            summary = contents_of_summary(self._stream)
            if summary is not None and not summary.is_checked and not isinstance(self.path, RemotePath):
                check_places(self._stream, summary)
        if damage.error:
            summary = None
        if summary is not None and self._source.options.recovery != "full_scan":
            self._use_definitions(summary)
            return profile, summary
        if damage.error:
            tell_full_read(self._stream, f"its summary cannot be used ({damage.reason})")
        elif summary is None:
            tell_full_read(self._stream, "its summary does not say all that is in it")
        else:
            tell_full_read(self._stream, "every record is wanted")
        scanned = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
        if summary is None and not scanned.counts and (damage.error or self.losses):
            raise damage.error or EOFError(self.losses[0].reason)
        self._definitions.know(scanned.schemas, scanned.channels, is_checked=True)
        return profile, scanned

    def _use_definitions(self, summary: Contents) -> None:
        """Take schemas and channels from the summary; without a checksum, after a comparison with the chunks."""
        self._definitions.know(summary.schemas, summary.channels, is_checked=summary.is_checked)
        if not summary.is_checked and not isinstance(self.path, RemotePath):
            try:
                confirm_definitions(self._stream, summary.chunks, self._definitions, self._limits)
            except LIBRARY_ERRORS as err:
                self._losses.reason(err)  # told when its messages are read
        summary.schemas, summary.channels = dict(self._definitions.schemas), dict(self._definitions.channels)

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        places = [None, *self._pass_places, None]
        for begin, end in pairwise(places):
            yield from self._messages_of(topics, start_ns, stop_ns, begin=begin, end=end)

    def _messages_of(
        self,
        topics: Collection[str] | None,
        start_ns: int | None,
        stop_ns: int | None,
        *,
        begin: FilePlace | None,
        end: FilePlace | None,
    ) -> Iterator[RawMessage]:
        """Those of one pass of the recorder's clock, which lies between two places of the file."""
        self._chunk_cache.begin()
        wanted = {id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics}
        start = 0 if start_ns is None else start_ns
        stop = 2**64 if stop_ns is None else stop_ns

        def taken(entry: Entry) -> bool:
            if entry.channel_id not in wanted or not start <= entry.log_time_ns < stop:
                return False
            place = (entry.chunk, entry.offset) if entry.chunk else (entry.offset, 0)
            return (begin is None or place >= begin) and (end is None or place < end)

        queue: list[Entry | ChunkPlace] = [entry for entry in self._loose if taken(entry)]
        places = [
            chunk
            for chunk in self._chunks
            if chunk.end_ns >= start
            and chunk.start_ns < stop
            and (not chunk.channel_ids or chunk.channel_ids & wanted)
            and (begin is None or chunk.position >= begin[0])
            and (end is None or chunk.position <= end[0])
        ]
        queue += places
        heapq.heapify(queue)
        ahead = ReadAhead(self._stream, [(place.position, place.size) for place in sorted(places)])
        left: Counter[int] = Counter()  # messages still to be yielded, by chunk
        while queue:
            place = heapq.heappop(queue)
            if isinstance(place, ChunkPlace):
                ahead.reach()
                for entry in self._entries_of(place, wanted, taken):
                    heapq.heappush(queue, entry)
                    left[place.position] += 1
                self._check_waiting(left)
                continue
            channel = self._channels[place.channel_id]
            data = self._read_or_note(place)
            left[place.chunk] -= 1
            if not left[place.chunk]:
                del left[place.chunk]
                self._chunk_cache.drop(place.chunk)
            if data is None:
                continue
            yield RawMessage(
                stamp_or_log_time(channel, data, place.log_time_ns),
                place.log_time_ns,
                (self._source.index, (place.chunk << 32) + place.offset),
                data,
                channel,
            )

    def _check_waiting(self, left: Counter[int]) -> None:
        """Refuse chunks that overlap in time so far that too many messages are in memory."""
        if left.total() > self._limits.max_positions_waiting:
            raise RecordingError(
                f"{self.path}: more than {self._limits.max_positions_waiting} messages of chunks that overlap in "
                "time: rewrite it in the order of time, or raise limits.max_positions_waiting"
            )

    def _entries_of(
        self, place: ChunkPlace, channel_ids: Collection[int], taken: Callable[[Entry], bool]
    ) -> list[Entry]:
        """The messages of some channels in a chunk that are taken; none if it is damaged, which is noted."""
        position = place.position
        if position in self._bad_chunks:
            return []
        with self._losses.guard() as damage:
            records = self._records_of(position)
            is_comparable = position != self._cut_chunk and not isinstance(self.path, RemotePath)
            if is_comparable and (listed := self._listed(place, records)) is not None:
                for opcode, at, size in listed.definitions:  # too late to use them
                    self._definitions.add(opcode, records[at : at + size], position, is_checked=False)
                return [entry for entry in listed.entries(position, channel_ids) if taken(entry)]
            entries = []
            for opcode, at, size in records_in(records, self._limits):
                if opcode == Opcode.MESSAGE:
                    entries.append(entry_of(records, at, position, at, size))
                elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:  # too late to use them
                    self._definitions.add(opcode, records[at : at + size], position, is_checked=False)
                elif opcode in OUTSIDE_OF_CHUNKS:
                    reason = f"a record with opcode {opcode} in a chunk, where none may be: it was another one"
                    self._losses.note(position, reason)
            if is_comparable and not agrees_with_index(self._stream, place, entries):
                reason = "the index behind this chunk does not agree with the messages in it, which are used"
                self._losses.note(position, reason, messages=0)
            return [entry for entry in entries if taken(entry)]
        self._bad_chunks.add(position)
        extent, count = chunk_extent(self._stream, position)
        self._losses.note(position, f"a chunk that cannot be read ({damage.reason})", size=extent, messages=count)
        return []

    def _listed(self, place: ChunkPlace, records: bytes) -> Listed | None:
        """What the index behind a chunk lists, if the chunk is just so."""
        try:
            rows = indexed_messages(self._stream, place)[:, 1:]
        except (EOFError, ValueError, struct.error):
            return None
        listed = as_listed(records, rows)
        if listed and len(rows) + len(listed.definitions) > self._limits.max_messages_per_chunk:
            return None
        return listed

    def _read_or_note(self, entry: Entry) -> bytes | memoryview | None:
        """The data of a message; None if they are damaged, which is noted."""
        try:
            return self._read(entry)
        except LIBRARY_ERRORS as err:
            where = f"a message at byte {entry.offset} of the chunk: " if entry.chunk else ""
            self._losses.note(entry.chunk or entry.offset, where + self._losses.reason(err), messages=1)
            return None

    def _read(self, entry: Entry) -> bytes | memoryview:
        self._check_open()
        if entry.chunk:
            data = detach(self._records_of(entry.chunk), entry.offset, entry.size)
        else:
            if entry.size > self._limits.max_message_bytes:
                raise ValueError(f"a message of {entry.size} bytes, see limits.max_message_mib")
            self._stream.seek(entry.offset)
            data = read_exactly(self._stream, entry.size)
        return decompressed(
            data,
            self._channels[entry.channel_id].encoding,
            announced=self._source.metadata.message_compression,
            largest=self._limits.max_message_bytes,
        )

    def _records_of(self, position: int) -> bytes:
        return self._chunk_cache.get(position, lambda: self._load(position))

    def _load(self, position: int) -> bytes:
        self._check_open()
        following = int(np.searchsorted(self._positions, np.uint64(position), side="right"))
        before = int(self._positions[following]) if following < len(self._positions) else None
        return load_chunk(self._stream, position, self._limits, before=before, is_cut=position == self._cut_chunk)
