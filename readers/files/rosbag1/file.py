"""ROS 1 bags, format 2.0 (http://wiki.ros.org/Bags/Format/2.0), with uncompressed, bz2 or lz4 chunks.

rosbags parses the index. Messages are read here: its own iterator leaves messages of equal time in the order of their
connections, and keeps one chunk only, which it decompresses anew at every change between overlapping chunks.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

from pipeline.core.arrays import I64
from pipeline.core.messages import RawMessage
from readers.files.chunk_cache import ChunkCache, detach
from readers.files.container import Container, Source
from readers.files.damage import LIBRARY_ERRORS
from readers.files.passes import pass_starts
from readers.files.rosbag1.index import Contents, contents_of_index, load_chunk
from readers.files.rosbag1.recovery import contents_of_scan
from readers.messages.header_stamp import stamp_or_log_time
from readers.recording import RosVersion, TopicInfo, merge_topics

__all__ = ["Rosbag1File"]

INDEX_BLOCK = 4096


class Rosbag1File(Container):
    """One open .bag file; see `RecordingFile`.

    Args:
        source: The file.
        content: Where its uncompressed content is.
    """

    ros_version: RosVersion = "ROS 1"

    def __init__(self, source: Source, content: Path) -> None:
        self._content = content
        super().__init__(source, content.open("rb"))

    def _describe(self) -> None:
        self._bad_chunks: set[int] = set()
        self._chunk_cache = ChunkCache(max_loaded_bytes=self._limits.max_unpacked_bytes(self._stream.seek(0, 2)))
        contents = self._read_contents()
        self._channels, self._chunks, self._index = contents.channels, contents.chunks, contents.index
        self._passes = _passes(contents.index)
        counts = _counts(self._index[:, 3])
        self.topics = merge_topics(
            TopicInfo(channel.topic, channel.msgtype, counts[id_], (channel,))
            for id_, channel in self._channels.items()
        )
        self.message_count = len(self._index)
        self.start_ns, self.end_ns = (int(self._index[i, 0]) if self.message_count else 0 for i in (0, -1))

    def _read_contents(self) -> Contents:
        """What the index says, or what a scan finds if there is no valid one."""
        indexed: Contents | None = None
        with self._losses.guard() as damage:
            indexed = contents_of_index(self._content)
        if indexed is not None and self._source.options.recovery != "full_scan":
            return indexed
        scanned = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
        if damage.error and not len(scanned.index):
            raise damage.error
        return scanned if indexed is None or len(scanned.index) else indexed

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        for index in self._passes:
            yield from self._messages_of(index, topics, start_ns, stop_ns)

    def _messages_of(
        self, index: I64, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """Those of one pass of the recorder's clock."""
        self._chunk_cache.begin()
        if topics is not None:
            wanted = [id_ for id_, channel in self._channels.items() if channel.topic in topics]
            index = index[np.isin(index[:, 3], wanted)]
        first, last = 0, len(index)
        if start_ns is not None:
            first = int(np.searchsorted(index[:, 0], start_ns))
        if stop_ns is not None:
            last = int(np.searchsorted(index[:, 0], stop_ns))
        left = _counts(index[first:last, 1])  # messages still to be yielded, by chunk
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
                    (self._source.index, (chunk_position << 32) + offset),  # offsets are uint32
                    data,
                    channel,
                )

    def _read_or_note(
        self, chunk_position: int, offset: int, connection_id: int, log_time_ns: int
    ) -> bytes | memoryview | None:
        """The data of a message; None if they are damaged, which is noted."""
        if chunk_position in self._bad_chunks:
            return None
        try:
            return self._read(chunk_position, offset, connection_id, log_time_ns)
        except LIBRARY_ERRORS as err:
            self._note(chunk_position, offset, self._losses.reason(err))
            return None

    def _note(self, chunk_position: int, offset: int, reason: str) -> None:
        """Note a message or its chunk as damaged."""
        chunk = self._chunks[chunk_position]
        if chunk.compression == "none":
            self._losses.note(chunk.data_position + offset, reason, messages=1)
        elif self._chunk_cache.holds(chunk_position):
            self._losses.note(chunk_position, f"a message at byte {offset} of the chunk: {reason}", messages=1)
        else:
            self._bad_chunks.add(chunk_position)
            count = self._chunk_counts[chunk_position]
            size = chunk.data_position + chunk.data_size - chunk_position
            self._losses.note(chunk_position, f"a chunk that does not unpack ({reason})", size=size, messages=count)

    @cached_property
    def _chunk_counts(self) -> Counter[int]:
        """Number of messages by chunk position."""
        return _counts(self._index[:, 1])

    def _read(self, chunk_position: int, offset: int, connection_id: int, log_time_ns: int) -> bytes | memoryview:
        self._check_open()
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


def _passes(index: I64) -> list[I64]:
    """The rows of each pass of the recorder's clock, as sorted as the index."""
    in_file = np.lexsort((index[:, 2], index[:, 1]))
    starts = pass_starts(index[in_file, 0], index[in_file, 3])
    if not starts:
        return [index]
    return [index[np.sort(rows)] for rows in np.split(in_file, starts)]


def _counts(values: I64) -> Counter[int]:
    unique, counts = np.unique(values, return_counts=True)
    return Counter(dict(zip(unique.tolist(), counts.tolist(), strict=True)))


def _seek_message(stream: BinaryIO, position: int, connection_id: int, log_time_ns: int) -> None:
    """Go to the data of the message whose record is at `position`.

    Raises:
        ValueError: the record is not the one that the index names.
    """
    stream.seek(position)
    header = Header.read(stream)
    while header.get_uint8("op") == RecordType.CONNECTION:  # some writers index the connection before its first message
        stream.seek(read_uint32(stream), 1)
        header = Header.read(stream)
    found = header.get_uint8("op"), header.get_uint32("conn"), header.get_time("time")
    if found != (RecordType.MSGDATA, connection_id, log_time_ns):
        raise ValueError(f"the index says message of connection {connection_id} at {position}, found {found}")
