"""MCAP channels by their message encoding and schema (mcap.dev/spec/registry).

One file may contain any mix of encodings, so the profile in its header is not used.
"""

import base64
from functools import lru_cache
from typing import Literal

from mcap.records import Channel as RecordedChannel
from mcap.records import Schema
from rosbags.typesys.msg import normalize_msgtype

from lidcam.pipeline.core.messages import Channel
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.foxglove import ROS_TYPES

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
