"""Two results in one MCAP file, to look at side by side.

The topics of the first one stand under `/a`, those of the second one under `/b`. Both have the site frame in common, so
that one 3D view shows both; the frames of their sensors have the same prefixes, because the rigs may differ.
The motion of the site frame itself is taken from the first result that has it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from typing import Any

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.qos import LATCHED_YAML
from lidcam.writers.foxglove.layout import COMPARED
from lidcam.writers.mcap.output import mcap_file
from lidcam.writers.messages.images import COMPRESSED
from lidcam.writers.outputs.errors import output_errors
from lidcam.writers.outputs.marks import MERGED
from lidcam.writers.outputs.transaction import OutputFile

_TF, _TF_STATIC, _TF_TYPE = "/tf", "/tf_static", "tf2_msgs/msg/TFMessage"
_CAMERA_TYPES = {
    "image": "sensor_msgs/msg/Image",
    "image/compressed": COMPRESSED,
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "detections": "vision_msgs/msg/Detection2DArray",
}
"""Types of the topics below a camera's name that have its frame in their headers."""


@dataclass(frozen=True, slots=True, eq=False)
class MergedSide:
    """One of the results.

    Attributes:
        name: Prefix of its topics and frames.
        rig: Its rig.
        channels: Its channels.
        messages: All of its messages, in the order of log time.
    """

    name: str
    rig: Rig
    channels: Sequence[Channel]
    messages: Iterator[RawMessage]


def write_merged(
    output: OutputFile,
    sides: Sequence[MergedSide],
    scenes: Iterator[tuple[int, Any]],
    metadata: Mapping[str, str],
) -> frozenset[str]:
    """Write two results to one new file.

    The results have one site frame. The scenes are log times and drawings of the differences, by rising log time; they
    are read along with the messages.

    Returns:
        The topics that have messages.

    Raises:
        OutputError: the file cannot be written.
        MessageError: a message of a result cannot be read.
    """
    with output_errors(output.path), mcap_file(output.part, profile="ros2") as file:
        file.add_metadata(MERGED, metadata)
        moving = next((side.name for side in sides if any(one.topic == _TF for one in side.channels)), "")
        sources = [_of_side(side, is_moving=side.name == moving) for side in sides]
        differences = ((time_ns, "~", COMPARED, scene.__msgtype__, ROS2.serialize(scene)) for time_ns, scene in scenes)
        ids: dict[tuple[str, Channel | str], int] = {}
        placed = merge(*sources, differences, key=lambda one: one[:2])  # what differs comes last of one log time
        for count, (log_time_ns, _, topic, kind, data) in enumerate(placed):
            if (topic, kind) not in ids:
                if isinstance(kind, Channel):
                    ids[topic, kind] = file.add_recorded(kind, topic)
                else:
                    ids[topic, kind] = file.add_ros2(topic, kind, LATCHED_YAML if topic == _TF_STATIC else "")
            file.add_message(ids[topic, kind], log_time_ns, data, count)
        return frozenset(topic for topic, _ in ids)


_Placed = tuple[int, str, str, Channel | str, bytes | memoryview]
"""Log time, name of the side, topic, its recorded channel or the type of lidcam's own messages, data."""


def _of_side(side: MergedSide, *, is_moving: bool) -> Iterator[_Placed]:
    """The messages of one result, under its names."""
    frames = _Frames(side, is_moving=is_moving)
    for message in side.messages:
        if message.problem:
            raise MessageError(f"{message.topic}: cannot be merged: {message.problem}")
        if message.topic not in {_TF, _TF_STATIC}:
            topic = f"/{side.name}{message.topic}"
            yield message.log_time_ns, side.name, topic, message.channel, frames.renamed(message)
        elif (data := frames.transforms(message)) is not None:
            yield message.log_time_ns, side.name, message.topic, _TF_TYPE, data


class _Frames:
    """Gives the frames of a result its name, but for the site frame and those that it moves in."""

    def __init__(self, side: MergedSide, *, is_moving: bool) -> None:
        self._name, self._site, self._is_moving = side.name, side.rig.site_frame, is_moving
        self._types = {
            f"/{camera.name}/{topic}": msgtype
            for camera in side.rig.cameras
            for topic, msgtype in _CAMERA_TYPES.items()
        }

    def renamed(self, message: RawMessage) -> bytes | memoryview:
        """A message, with another frame in its header if that is the frame of a camera."""
        msgtype = self._types.get(message.topic)
        if (msgtype, "cdr") != (message.channel.msgtype, message.channel.encoding):
            return message.data
        read = _read(message)
        for part in (read, *getattr(read, "detections", ())):
            part.header.frame_id = self._renamed(part.header.frame_id)
        return ROS2.serialize(read)

    def transforms(self, message: RawMessage) -> bytes | memoryview | None:
        """The transforms, with the new names of the frames; None if nothing is left of them."""
        read = _read(message)
        read.transforms = [one for one in read.transforms if self._is_moving or one.child_frame_id != self._site]
        for one in read.transforms:
            if one.child_frame_id != self._site:
                one.header.frame_id = self._renamed(one.header.frame_id)
                one.child_frame_id = self._renamed(one.child_frame_id)
        return ROS2.serialize(read) if read.transforms else None

    def _renamed(self, frame_id: str) -> str:
        return frame_id if frame_id == self._site else f"{self._name}/{frame_id}"


def _read(message: RawMessage) -> Any:
    try:
        return ROS2.deserialize(message.data, message.channel.msgtype)
    except Exception as err:  # whatever the library raises about bytes that do not fit
        raise MessageError(f"{message.topic}: cannot be merged: {err or type(err).__name__}") from err
