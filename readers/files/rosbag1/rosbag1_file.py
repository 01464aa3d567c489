"""ROS 1 bags, format 2.0 (http://wiki.ros.org/Bags/Format/2.0), with uncompressed, bz2 or lz4 chunks.

The index says where the chunks are; the messages are those that a chunk holds. rosbags' own reader keeps an entry for
every message of the bag in memory, and leaves messages of equal time in the order of their connections.
"""

import struct
from collections.abc import Iterator

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.readers.files.chunked import ChunkedFile, ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.decompress import check_chunk_size, unpack
from lidcam.readers.files.rosbag1.records import (
    INDEX,
    MESSAGE,
    MESSAGE_BEGIN,
    UINT32,
    contents_of_chunk,
    contents_of_index,
    read_record,
)
from lidcam.readers.files.rosbag1.recovery import contents_of_scan
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics

UINT32S = struct.Struct("<II")
ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])


class Rosbag1File(ChunkedFile):
    """One open .bag file; see `RecordingFile`."""

    ros_version: RosVersion = "ROS 1"

    def _describe(self) -> None:
        with self._losses.guard() as damage:
            contents = contents_of_index(self._stream)
        self._is_scanned = damage.error is not None or self._source.options.recovery == "full_scan"
        if self._is_scanned:
            contents = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
            if damage.error and not contents.chunks:
                raise damage.error
        self._data = contents.data
        self._set_contents(contents.chunks, [], contents.channels, None if self._is_scanned else contents.channels)
        self.topics = merge_topics(
            TopicInfo(channel.topic, channel.msgtype, contents.counts[id_], (channel,))
            for id_, channel in contents.channels.items()
        )
        self.message_count = contents.counts.total()
        filled = [place for place in contents.chunks if place.messages]
        self.start_ns = min((place.start_ns for place in filled), default=0)
        self.end_ns = max((place.end_ns for place in filled), default=0)

    def _load(self, position: int) -> bytes:
        data, largest = self._data[position], self._limits.max_chunk_bytes
        if data.compression == "none":
            check_chunk_size(data.size, largest)
            self._stream.seek(data.position)
            return read_exactly(self._stream, data.size)
        return unpack(
            self._stream,
            data.position,
            data.position + data.size,
            data.compression,
            largest=largest,
            size=data.unpacked_size,
            may_be_cut=data.is_cut,
        ).data

    def _entries_in(self, position: int, records: bytes) -> list[Entry]:
        entries: list[Entry] = []
        at, end = 0, len(records)
        while at < end and (match := MESSAGE_BEGIN.match(records, at)) and None not in match.groups():
            conn, _, time, size_bytes = match.groups()
            (sec, nanosec), (size,), (id_,) = UINT32S.unpack(time), UINT32.unpack(size_bytes), UINT32.unpack(conn)
            entries.append(Entry(sec * 10**9 + nanosec, position, match.end(), size, id_))
            at = match.end() + size
        if at == end and len(entries) <= self._limits.max_messages_per_chunk:  # nothing but messages
            return entries
        return [
            Entry(record.time_of(b"time"), position, record.data, record.size, record.number(b"conn"))
            for record in contents_of_chunk(records, self._limits)
            if record.kind == MESSAGE
        ]

    def _indexed(self, place: ChunkPlace) -> I64:
        """From the index records that follow the chunk; from the chunk itself in a bag whose index is lost."""
        if self._is_scanned:
            found = self._entries_of(place)
            return np.array([(e.chunk, e.offset, e.log_time_ns, e.channel_id) for e in found], np.int64).reshape(-1, 4)
        return np.concatenate([np.zeros((0, 4), np.int64), *self._indexes_behind(place)])

    def _indexes_behind(self, place: ChunkPlace) -> Iterator[I64]:
        end = self._stream.seek(0, 2)
        record = read_record(self._stream, place.position + place.size, end)
        while record is not None and record.kind == INDEX:
            self._stream.seek(record.data)
            listed = np.frombuffer(read_exactly(self._stream, record.size), ENTRY)
            rows = np.empty((len(listed), 4), np.int64)
            rows[:, 0] = place.position
            rows[:, 1] = listed["offset"]
            rows[:, 2] = listed["sec"] * np.int64(10**9) + listed["nanosec"]
            rows[:, 3] = record.number(b"conn")
            yield rows
            record = read_record(self._stream, record.end, end)
