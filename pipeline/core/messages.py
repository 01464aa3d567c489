"""Recorded messages, before anything is decoded."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

__all__ = ["Channel", "Drop", "RawMessage"]


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of one recording file: what is needed to decode its messages.

    Attributes:
        topic: Topic name.
        msgtype: Type name in the ROS 2 spelling, for instance `sensor_msgs/msg/PointCloud2`.
        encoding: Serialisation of the bytes.
        definition: Message definition text as recorded, a protobuf FileDescriptorSet in base64; empty where the
            recording has none.
        definition_format: Says how to read `definition`.
        distro: Name of the ROS 2 release that the recording names, or empty.
        digest: What the recorder knew the type by: ROS 1's md5sum or a ROS 2 type hash (REP 2011); empty where the
            recording does not say.
    """

    topic: str
    msgtype: str
    encoding: Literal["ros1", "cdr", "protobuf", "json"]
    definition: str = ""
    definition_format: Literal["ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"] = "ros2msg"
    distro: str = ""
    digest: str = ""


class RawMessage(NamedTuple):
    """One recorded message, not decoded yet.

    Attributes:
        stamp_ns: Header stamp; `log_time_ns` where the type has no header.
        log_time_ns: Time of recording.
        order: (file index, position in the file), then the place within what was recorded as one message: makes the
            order of equal times total.
        data: The serialised message.
        channel: Topic, type and definition.
        problem: Why there are no data, where what was recorded cannot be read; empty if it can.
        defects: Of a message made of several recorded ones: what was wrong with those that could not be used.
    """

    stamp_ns: int
    log_time_ns: int
    order: tuple[int, ...]
    data: bytes | memoryview
    channel: Channel
    problem: str = ""
    defects: tuple[str, ...] = ()

    @property
    def topic(self) -> str:
        """Topic name."""
        return self.channel.topic


class Drop(NamedTuple):
    """One message that took no part, or parts of one of which the rest did, and why.

    Attributes:
        topic: Its topic.
        stamp_ns: Its stamp.
        reason: Why, in words that are the same for all messages with this fate.
        detail: What was found in this very message; may be empty.
        parts: How many of its parts took none, where the rest of it did; 0: the whole message.
    """

    topic: str
    stamp_ns: int
    reason: str
    detail: str = ""
    parts: int = 0
