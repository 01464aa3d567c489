"""ROS 1 bags, format 2.0 (http://wiki.ros.org/Bags/Format/2.0), with chunks as they are, bz2 or lz4.

rosbags parses the index; the messages are fetched here, because its own iterator leaves the order of equal times to the
order of connections, keeps one chunk only, and decompresses it anew at every change between overlapping chunks.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

from pipeline.core.errors import RecordingError
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.files.chunk_cache import ChunkCache, detach
from readers.files.damage import Losses, describe, is_damage
from readers.files.rosbag1.index import Contents, contents_of_index, contents_of_walk, load_chunk
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import Loss, RosVersion, TopicInfo, merge_topics

__all__ = ["Rosbag1File"]

INDEX_BLOCK = 4096


class Rosbag1File:
    """One open .bag file; see `RecordingFile`.

    Args:
        path: The file.
        file_index: Its place in the recording.
        location: Where it lies unpacked, if not at `path`.
        rescue: Read what can be read of a damaged file, and tell of the rest in `losses`.
        thorough: Do so by reading every record, even where the index seems right.
        limits: How much it may unpack to.
    """

    ros_version: RosVersion = "ROS 1"

    def __init__(
        self,
        path: Path,
        file_index: int,
        *,
        location: Path | None = None,
        rescue: bool = False,
        thorough: bool = False,
        limits: LimitsConfig = DEFAULT_LIMITS,
    ) -> None:
        self.path = path
        self._file_index = file_index
        self._limits = limits
        self._rescue = rescue
        self._losses = Losses(path, limits.max_losses_listed)
        self._bad_chunks: set[int] = set()
        location = path if location is None else location
        self._chunk_cache = ChunkCache(max_loaded_bytes=limits.max_unpacked_bytes(location.stat().st_size))
        contents: Contents | None = None
        fault: Exception | None = None
        try:
            contents = contents_of_index(location)
        except Exception as err:
            if not rescue or not is_damage(err):
                raise
            fault = err
        self._stream: BinaryIO = location.open("rb")
        try:
            if contents is None or thorough:
                contents = self._walked(contents, fault)
        except BaseException:
            self._stream.close()
            raise
        self._channels, self._chunks, self._index = contents.channels, contents.chunks, contents.index
        counts = Counter(
            dict(zip(*(a.tolist() for a in np.unique(self._index[:, 3], return_counts=True)), strict=True))
        )
        self.topics = merge_topics(
            TopicInfo(channel.topic, channel.msgtype, counts[id_], (channel,))
            for id_, channel in self._channels.items()
        )
        self.message_count = len(self._index)
        self.start_ns, self.end_ns = (int(self._index[i, 0]) if self.message_count else 0 for i in (0, -1))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """See `RecordingFile`."""
        return self._losses.listed()

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        self._chunk_cache.begin()
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
                data = self._read_or_note(chunk_position, offset, connection_id, log_time_ns)
                left[chunk_position] -= 1
                if not left[chunk_position]:
                    self._chunk_cache.drop(chunk_position)
                if data is None:
                    continue
                yield RawMessage(
                    stamp_or_log_time(channel, data, log_time_ns),
                    log_time_ns,
                    (self._file_index, (chunk_position << 32) + offset),  # offsets are uint32
                    data,
                    channel,
                )

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _walked(self, indexed: Contents | None, fault: Exception | None) -> Contents:
        """What is found without the index.

        Raises:
            Exception: `fault`, where nothing is.
        """
        walked = contents_of_walk(
            self._stream, self._losses, because=describe(fault) if fault else "", limits=self._limits
        )
        if len(walked.index):
            return walked
        if fault is not None:
            raise fault
        return walked if indexed is None else indexed

    def _read_or_note(
        self, chunk_position: int, offset: int, connection_id: int, log_time_ns: int
    ) -> bytes | memoryview | None:
        """The data of a message; None where they are damaged, which is noted."""
        chunk = self._chunks[chunk_position]
        if chunk_position in self._bad_chunks:
            return None
        try:
            return self._read(chunk_position, offset, connection_id, log_time_ns)
        except Exception as err:
            if not self._rescue or not is_damage(err):
                raise
            if chunk.compression == "none":
                self._losses.note(chunk.data_position + offset, describe(err), messages=1)
            elif self._chunk_cache.holds(chunk_position):
                reason = f"a message at byte {offset} of the chunk: {describe(err)}"
                self._losses.note(chunk_position, reason, messages=1)
            else:
                self._bad_chunks.add(chunk_position)
                count = self._chunk_counts[chunk_position]
                size = chunk.data_position + chunk.data_size - chunk_position
                reason = f"a chunk that does not unpack ({describe(err)})"
                self._losses.note(chunk_position, reason, size=size, messages=count)
            return None

    @cached_property
    def _chunk_counts(self) -> dict[int, int]:
        """Messages by chunk."""
        positions, counts = np.unique(self._index[:, 1], return_counts=True)
        return dict(zip(positions.tolist(), counts.tolist(), strict=True))

    def _read(self, chunk_position: int, offset: int, connection_id: int, log_time_ns: int) -> bytes | memoryview:
        if self._stream.closed:
            raise RecordingError(f"{self.path}: expected an open recording, but it was closed")
        chunk = self._chunks[chunk_position]
        if chunk.compression == "none":
            _seek_message(self._stream, chunk.data_position + offset, connection_id, log_time_ns)
            size = read_uint32(self._stream)
            if size > self._limits.max_message_bytes:
                raise ValueError(f"a message of {size} bytes, see limits.max_message_mib")
            if chunk.data_size and self._stream.tell() + size > chunk.data_position + chunk.data_size:
                raise ValueError(f"a message of {size} bytes reaches beyond its chunk of {chunk.data_size}")
            return read_bytes(self._stream, size)
        records = self._chunk_cache.get(
            chunk_position, lambda: load_chunk(self._stream, chunk_position, chunk, self._limits)
        )
        stream = BytesIO(records)  # shares the bytes
        _seek_message(stream, offset, connection_id, log_time_ns)
        size = read_uint32(stream)
        return detach(records, stream.tell(), size)


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
