"""Recorded messages, undecoded."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from lidcam.pipeline.core.text import brief

MAX_TIME_NS = 2**31 * 10**9 - 1
"""The last time that a ROS 2 header can hold, in January 2038. MCAP, ROS 1, numpy and the viewers reach further."""


def time_fault(time_ns: int) -> str:
    """Why a number cannot be a stamp or a log time that every output can hold; empty if it can."""
    if 0 <= time_ns <= MAX_TIME_NS:
        return ""
    return f"{time_ns} ns lies {'before 1970' if time_ns < 0 else 'after January 2038'}"


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic of one file of a recording, with what is needed to decode its messages."""

    topic: str  # Topic name
    msgtype: str  # Type name in the ROS 2 spelling, for instance `sensor_msgs/msg/PointCloud2`
    encoding: Literal["ros1", "cdr", "protobuf", "json"]  # Serialisation of the bytes
    definition: str = ""  # Recorded message definition: text, or a protobuf FileDescriptorSet in base64; empty if none
    # Format of `definition`
    definition_format: Literal["ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"] = "ros2msg"
    distro: str = ""  # ROS 2 release named by the recording, or empty
    # Recorded identity of the type: ROS 1's md5sum or a ROS 2 type hash (REP 2011); empty if there is none
    digest: str = ""

    __repr__ = brief


class RawMessage(NamedTuple):
    """One recorded message, undecoded.

    Attributes:
        stamp_ns: Header stamp; `log_time_ns` if the type has no header.
        log_time_ns: Time of recording.
        order: (file index, position in the file), then the position within a combined message; orders messages of equal
            times.
        data: The serialised message.
        channel: Topic, type and definition.
        problem: Why the message cannot be read and `data` is empty; empty if it can.
        defects: For a message put together from several recorded ones, errors of those that were not used.
    """

    stamp_ns: int
    log_time_ns: int
    order: tuple[int, ...]
    data: bytes | memoryview
    channel: Channel
    problem: str = ""
    defects: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return brief(self)

    @property
    def topic(self) -> str:
        """Topic name."""
        return self.channel.topic


class VideoPart(NamedTuple):
    """Packets of a video as they were recorded, one image each, in the order of decoding."""

    codec: str  # `h264`, `hevc`, `vp9`, `av1`, `vp8`, `mpeg4` or `mjpeg`
    packets: tuple[bytes, ...]


class Drop(NamedTuple):
    """A message, or with `parts` some parts of one, that was not used."""

    topic: str  # Its topic
    stamp_ns: int  # Its stamp
    reason: str  # Why; the same text for all messages dropped for this reason
    detail: str = ""  # Details of this message; may be empty
    parts: int = 0  # Number of parts not used, if the rest of the message was; 0 for the whole message
