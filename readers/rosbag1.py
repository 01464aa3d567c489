"""ROS 1 bags, format 2.0 (http://wiki.ros.org/Bags/Format/2.0), with chunks as they are, bz2 or lz4.

rosbags parses the index; the messages are fetched here, because its own iterator leaves the order of equal times to the
order of connections, keeps one chunk only, and decompresses it anew at every change between overlapping chunks.
"""

from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Header, RecordType, decompressors, read_bytes, read_uint32

from pipeline.errors import RecordingError
from pipeline.types import Channel, RawMessage
from readers.base import RosVersion, TopicInfo, merge_topics
from readers.chunks import ChunkCache, detach
from readers.peek import stamp_or_log_time

__all__ = ["Rosbag1File"]

INDEX_BLOCK = 4096


class Rosbag1File:
    """One open .bag file; see `RecordingFile`."""

    ros_version: RosVersion = "ROS 1"

    def __init__(self, path: Path, file_index: int, *, location: Path | None = None) -> None:
        self.path = path
        self._file_index = file_index
        self._chunk_cache = ChunkCache()
        self._reader = Reader(path if location is None else location)
        self._reader.open()
        try:
            self._index = _index_of(self._reader)
        except BaseException:
            self._reader.close()
            raise
        self._channels = {
            connection.id: Channel(connection.topic, connection.msgtype, "ros1", connection.msgdef.data, "ros1msg")
            for connection in self._reader.connections
        }
        self.topics = merge_topics(
            TopicInfo(connection.topic, connection.msgtype, connection.msgcount, (self._channels[connection.id],))
            for connection in self._reader.connections
        )
        self.message_count = len(self._index)
        self.start_ns, self.end_ns = (int(self._index[i, 0]) if self.message_count else 0 for i in (0, -1))

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        index = self._index
        if topics is not None:
            wanted = [id_ for id_, channel in self._channels.items() if channel.topic in topics]
            index = index[np.isin(index[:, 3], wanted)]
        first, last = 0, len(index)
        if start_ns is not None:
            first = int(np.searchsorted(index[:, 0], start_ns))
        if stop_ns is not None:
            last = int(np.searchsorted(index[:, 0], stop_ns))
        positions, counts = np.unique(index[first:last, 1], return_counts=True)
        left = dict(zip(positions.tolist(), counts.tolist(), strict=True))  # messages to come by chunk
        for begin in range(first, last, INDEX_BLOCK):
            for log_time_ns, chunk_position, offset, connection_id in index[
                begin : min(begin + INDEX_BLOCK, last)
            ].tolist():
                channel = self._channels[connection_id]
                data = self._read(chunk_position, offset, connection_id, log_time_ns)
                left[chunk_position] -= 1
                if not left[chunk_position]:
                    self._chunk_cache.drop(chunk_position)
                yield RawMessage(
                    stamp_or_log_time(channel, data, log_time_ns),
                    log_time_ns,
                    (self._file_index, (chunk_position << 32) + offset),  # offsets are uint32
                    data,
                    channel,
                )

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def _read(self, chunk_position: int, offset: int, connection_id: int, log_time_ns: int) -> bytes | memoryview:
        chunk = self._reader.chunks[chunk_position]
        stream = self._stream()
        if chunk.decompressor is decompressors["none"]:
            _seek_message(stream, chunk.datapos + offset, connection_id, log_time_ns)
            return read_bytes(stream, read_uint32(stream))

        def load() -> bytes:
            stream.seek(chunk.datapos)
            return chunk.decompressor(read_bytes(stream, chunk.datasize))

        records = self._chunk_cache.get(chunk_position, load)
        stream = BytesIO(records)  # shares the bytes
        _seek_message(stream, offset, connection_id, log_time_ns)
        size = read_uint32(stream)
        return detach(records, stream.tell(), size)

    def _stream(self) -> BinaryIO:
        if self._reader.bio is None:
            raise RecordingError(f"{self.path}: expected an open recording, but it was closed")
        return self._reader.bio


def _index_of(reader: Reader) -> npt.NDArray[np.int64]:
    """All messages (N, 4): log time, position of the chunk, offset in it, connection; in that order."""
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
    if not parts:
        return np.zeros((0, 4), np.int64)
    index = np.concatenate(parts)
    return index[np.lexsort((index[:, 2], index[:, 1], index[:, 0]))]


def _seek_message(stream: BinaryIO, position: int, connection_id: int, log_time_ns: int) -> None:
    """Go to the data of the message whose record is at `position`.

    Raises:
        ValueError: another record is there than the index says.
    """
    stream.seek(position)
    header = Header.read(stream)
    while header.get_uint8("op") == RecordType.CONNECTION:  # some writers index the connection before its first message
        stream.seek(read_uint32(stream), 1)
        header = Header.read(stream)
    found = header.get_uint8("op"), header.get_uint32("conn"), header.get_time("time")
    if found != (RecordType.MSGDATA, connection_id, log_time_ns):
        raise ValueError(f"the index says message of connection {connection_id} at {position}, found {found}")
