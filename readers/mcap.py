"""MCAP recordings (https://mcap.dev/spec), ROS 2 (cdr) and ROS 1, chunks as they are, lz4 or zstd, or no chunks.

The mcap library parses summary and chunks. The order of messages is made here: the library's own queue holds every
message of all chunks that overlap in time, and reads a file without chunk index into memory as a whole.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO, Literal

import zstandard
from mcap.reader import SeekingReader
from rosbags.typesys.msg import normalize_msgtype

from pipeline.types import Channel, RawMessage
from readers.base import RosVersion, TopicInfo, merge_topics
from readers.chunks import ChunkCache, detach
from readers.mcap_contents import ChunkPlace, Entry, load_chunk, messages_in, read_contents, read_exactly
from readers.peek import stamp_or_log_time

__all__ = ["McapFile"]

Definition = Literal["ros1msg", "ros2msg", "ros2idl"]
DEFINITIONS: dict[tuple[str, str], Definition] = {
    ("ros1", "ros1msg"): "ros1msg",
    ("cdr", "ros2msg"): "ros2msg",
    ("cdr", "ros2idl"): "ros2idl",
    ("cdr", ""): "ros2msg",  # rosbag2 writes an empty schema where it knows the type's name only
}


class McapFile:
    """One open MCAP file; see `RecordingFile`.

    Args:
        path: The file.
        file_index: Its place in the recording.
        location: Where it lies unpacked, if not at `path`.
        message_compression: Whether each message is compressed with zstd (metadata.yaml says so).
        distro: ROS 2 release that metadata.yaml names.
    """

    ros_version: RosVersion

    def __init__(
        self,
        path: Path,
        file_index: int,
        *,
        location: Path | None = None,
        message_compression: bool = False,
        distro: str = "",
    ) -> None:
        self.path = path
        self._file_index = file_index
        self._decompressor = zstandard.ZstdDecompressor() if message_compression else None
        self._chunk_cache = ChunkCache()
        self._stream: BinaryIO = (path if location is None else location).open("rb")
        try:
            self._describe(distro)
        except BaseException:
            self._stream.close()
            raise

    def _describe(self, distro: str) -> None:
        reader = SeekingReader(self._stream)
        profile = reader.get_header().profile
        contents = read_contents(reader, self._stream)
        self._chunks, self._loose = contents.chunks, contents.loose
        self._channels: dict[int, Channel] = {}
        topics = []
        for id_, recorded in sorted(contents.channels.items()):
            schema = contents.schemas.get(recorded.schema_id)
            name = schema.name if schema else ""
            msgtype = normalize_msgtype(name) if "/" in name else name
            count = contents.counts[id_]
            definition_format = DEFINITIONS.get((recorded.message_encoding, schema.encoding)) if schema else None
            if schema is None or definition_format is None:
                found = f"{recorded.message_encoding or 'no'} encoding, {schema.encoding if schema else 'no'} schema"
                reason = f"its messages have {found}; lidcam reads cdr (ros2msg, ros2idl) and ros1 (ros1msg)"
                topics.append(TopicInfo(recorded.topic, msgtype, count, (), reason))
                continue
            encoding: Literal["ros1", "cdr"] = "ros1" if recorded.message_encoding == "ros1" else "cdr"
            channel = Channel(recorded.topic, msgtype, encoding, schema.data.decode(), definition_format, distro)
            self._channels[id_] = channel
            topics.append(TopicInfo(recorded.topic, msgtype, count, (channel,)))
        self.topics = merge_topics(topics)
        self.message_count = contents.counts.total()
        self.start_ns, self.end_ns = (contents.start_ns, contents.end_ns) if self.message_count else (0, 0)
        encodings = {channel.encoding for channel in self._channels.values()}
        self.ros_version = "ROS 1" if profile == "ros1" or encodings == {"ros1"} else "ROS 2"

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        wanted = {id_ for id_, channel in self._channels.items() if topics is None or channel.topic in topics}
        start = 0 if start_ns is None else start_ns
        stop = 2**64 if stop_ns is None else stop_ns

        def taken(entry: Entry) -> bool:
            return entry.channel_id in wanted and start <= entry.log_time_ns < stop

        queue: list[Entry | ChunkPlace] = [entry for entry in self._loose if taken(entry)]
        queue += [
            chunk
            for chunk in self._chunks
            if chunk.end_ns >= start and chunk.start_ns < stop and (not chunk.channel_ids or chunk.channel_ids & wanted)
        ]
        heapq.heapify(queue)
        left: Counter[int] = Counter()  # messages to come by chunk
        while queue:
            place = heapq.heappop(queue)
            if isinstance(place, ChunkPlace):
                for entry in messages_in(self._records_of(place.position), place.position):
                    if taken(entry):
                        heapq.heappush(queue, entry)
                        left[place.position] += 1
                continue
            channel = self._channels[place.channel_id]
            data = self._read(place)
            left[place.chunk] -= 1
            if not left[place.chunk]:
                del left[place.chunk]
                self._chunk_cache.drop(place.chunk)
            yield RawMessage(
                stamp_or_log_time(channel, data, place.log_time_ns),
                place.log_time_ns,
                (self._file_index, (place.chunk << 32) + place.offset),
                data,
                channel,
            )

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _read(self, entry: Entry) -> bytes | memoryview:
        if entry.chunk:
            data = detach(self._records_of(entry.chunk), entry.offset, entry.size)
        else:
            self._stream.seek(entry.offset)
            data = read_exactly(self._stream, entry.size)
        return data if self._decompressor is None else self._decompressor.decompress(data)

    def _records_of(self, position: int) -> bytes:
        return self._chunk_cache.get(position, lambda: load_chunk(self._stream, position))
