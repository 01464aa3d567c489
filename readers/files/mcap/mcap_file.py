"""MCAP recordings (https://mcap.dev/spec), with chunks (uncompressed, lz4 or zstd) or without.

What a channel holds is told by its message encoding and schema (mcap.dev/spec/registry): one file may have any mix of
them, so the profile in its header is not used. The mcap library parses the summary. Messages are ordered here: the
library's own queue holds every message of all chunks that overlap in time, and it reads a file without chunk index into
memory as a whole.
"""

import base64
from functools import lru_cache
from typing import Literal

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel as RecordedChannel
from mcap.records import Schema
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.messages import Channel
from lidcam.pipeline.core.text import one_line
from lidcam.readers.files.chunked import ChunkedFile, ChunkPlace, Entry
from lidcam.readers.files.container import read_exactly
from lidcam.readers.files.mcap.records import (
    INDEX_HEAD,
    PAIR_BYTES,
    RECORD_HEAD,
    Contents,
    contents_of_summary,
    entry_of,
    load_chunk,
    read_profile,
    records_in,
)
from lidcam.readers.files.mcap.recovery import contents_of_scan
from lidcam.readers.files.remote import warn_of_full_read
from lidcam.readers.messages.foxglove import ROS_TYPES
from lidcam.readers.recording import RosVersion, TopicInfo, merge_topics

Encoding = Literal["ros1", "cdr", "protobuf", "json"]
Definition = Literal["ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"]
DEFINITIONS: dict[tuple[str, str], tuple[Encoding, Definition]] = {
    ("ros1", "ros1msg"): ("ros1", "ros1msg"),
    ("ros1", ""): ("ros1", "ros1msg"),
    ("cdr", "ros2msg"): ("cdr", "ros2msg"),
    ("cdr", "ros2idl"): ("cdr", "ros2idl"),
    ("cdr", ""): ("cdr", "ros2msg"),  # rosbag2 writes an empty schema if it knows only the name of the type
    ("protobuf", "protobuf"): ("protobuf", "protobuf"),
    ("json", "jsonschema"): ("json", "jsonschema"),
}


class McapFile(ChunkedFile):
    """One open MCAP file; see `RecordingFile`."""

    ros_version: RosVersion

    def _describe(self) -> None:
        profile, contents, is_scanned = self._read_contents()
        self._sizes = {place.position: place.size for place in contents.chunks}
        channels: dict[int, Channel] = {}
        topics = []
        for id_, recorded in sorted(contents.channels.items()):
            schema = contents.schemas.get(recorded.schema_id)
            channel = channel_of(recorded, schema, self._source.metadata.distro)
            count = contents.counts[id_]
            if isinstance(channel, str):
                topics.append(TopicInfo(recorded.topic, message_type(schema), count, (), channel))
                continue
            channels[id_] = channel
            topics.append(TopicInfo(recorded.topic, channel.msgtype, count, (channel,)))
        known_ids = None if is_scanned else contents.channels
        self._set_contents(contents.chunks, contents.loose, channels, known_ids)
        self.topics = merge_topics(topics)
        self.message_count = contents.counts.total()
        self.start_ns, self.end_ns = (contents.start_ns, contents.end_ns) if self.message_count else (0, 0)
        encodings = {channel.encoding for channel in channels.values()}
        self.ros_version = "ROS 1" if profile == "ros1" or encodings == {"ros1"} else "ROS 2"

    def _read_contents(self) -> tuple[str, Contents, bool]:
        """Profile, contents, and whether these are not from the summary but from a scan."""
        profile, summary = "", None
        with self._losses.guard() as damage:
            profile = read_profile(self._stream)
            summary = contents_of_summary(self._stream)
        if summary is not None and self._source.options.recovery != "full_scan":
            return profile, summary, False
        because = "every record is wanted"
        if damage.error or summary is None:
            because = f"its summary cannot be used ({damage.reason or 'it does not say all that is in the file'})"
        warn_of_full_read(self._stream, because)
        scanned = contents_of_scan(self._stream, self._losses, because=damage.reason, limits=self._limits)
        if summary is None and not scanned.counts and (damage.error or self.losses):
            raise damage.error or EOFError(self.losses[0].reason)
        return profile, scanned, True

    def _load(self, position: int) -> bytes:
        return load_chunk(self._stream, position, self._limits, size=self._sizes[position])

    def _entries_in(self, position: int, records: bytes) -> list[Entry]:
        found = records_in(records, self._limits)
        return [entry_of(records, at, position, at, size) for opcode, at, size in found if opcode == Opcode.MESSAGE]

    def _indexed(self, place: ChunkPlace) -> I64:
        """From the index records that follow the chunk; none without them."""
        found = [np.zeros((0, 4), np.int64)]
        self._stream.seek(place.position + place.size)
        while True:
            opcode, size = RECORD_HEAD.unpack(read_exactly(self._stream, RECORD_HEAD.size))
            if opcode != Opcode.MESSAGE_INDEX:
                return np.concatenate(found)
            content = read_exactly(self._stream, size)
            channel_id, pair_bytes = INDEX_HEAD.unpack_from(content)
            pairs = np.frombuffer(content, "<u8", pair_bytes // PAIR_BYTES * 2, INDEX_HEAD.size).reshape(-1, 2)
            columns = np.full(len(pairs), place.position), pairs[:, 1], pairs[:, 0], np.full(len(pairs), channel_id)
            found.append(np.stack([column.astype(np.int64) for column in columns], axis=1))


def message_type(schema: Schema | None) -> str:
    """Name of the type, in the ROS 2 spelling if it is a ROS type; empty if there is no schema."""
    if schema is None:
        return ""
    return normalize_msgtype(schema.name) if "/" in schema.name else schema.name


def channel_of(recorded: RecordedChannel, schema: Schema | None, distro: str) -> Channel | str:
    """The channel, or why its messages cannot be read; `distro` is the name of the ROS 2 release, or empty."""
    known = DEFINITIONS.get((recorded.message_encoding, schema.encoding)) if schema else None
    msgtype = message_type(schema)
    if schema is None or known is None or (known[0] in {"protobuf", "json"} and msgtype not in ROS_TYPES):
        found = f"{recorded.message_encoding or 'no'} encoding, {schema.encoding if schema else 'no'} schema {msgtype}"
        return (
            f"its messages have {one_line(found)}; lidcam reads cdr (ros2msg, ros2idl), ros1 (ros1msg), and in "
            f"protobuf and json {', '.join(ROS_TYPES)}"
        )
    encoding, definition_format = known
    definition = _definition(schema.data, encoding == "protobuf")
    digest = recorded.metadata.get("md5sum" if encoding == "ros1" else "topic_type_hash", "")
    return Channel(recorded.topic, msgtype, encoding, definition, definition_format, distro, digest)


@lru_cache(maxsize=256)  # thousands of channels may have one schema
def _definition(data: bytes, is_binary: bool) -> str:
    if is_binary:
        return base64.b64encode(data).decode()
    return data.decode(errors="replace")  # invalid text makes the topic unreadable, not the recording
