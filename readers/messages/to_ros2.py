"""Recorded ROS messages as CDR with definitions of ROS 2, to be written to a ROS 2 file.

CDR messages stay byte for byte as they are. A ROS 1 type takes the definition that ROS 2 Humble has under its name if
that holds all of its fields (`sensor_msgs/CameraInfo`: `D` becomes `d`), else it keeps its own; a header loses `seq`.

ROS 1's vision_msgs do not fit those of ROS 2: they number classes where ROS 2 names them, and have no field for whose
box it is. The simulator therefore records counts and the instance as hypotheses with negative numbers
(docs/simulator.md); in ROS 2 these are hypotheses with names, and the instance is `id`. The empty `source_cloud` and
`source_img` of ROS 1 have no place in ROS 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.typestores import known_type
from lidcam.pipeline.core.ros.vision_numbers import CLASS_OF_NUMBER, COUNT_NUMBERS, count_of
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize, pose_numbers, type_parts, typestore_for

HEADER = "std_msgs/msg/Header"

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Types that ROS 2 calls otherwise, as rosbags has them, whose converter takes long to import."""

_BOXES_3D, _BOXES_2D = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"

VISION_ARRAYS = frozenset({_BOXES_2D, _BOXES_3D})

INSTANCE = COUNT_NUMBERS["instance"]
"""Number of the hypothesis whose score says which object it is."""


def class_name_of_number(number: int, classes: Sequence[ClassPrior]) -> str:
    """Name of a class that a recording numbers.

    The class is the one that has the number among its labels. Where the simulator's name for that number is one of the
    labels, too, it is the name (4 is `van`, although vans count as trucks); else the name of the class is; the number
    itself if no class has it.
    """
    for prior in classes:
        if str(number) in prior.labels:
            simulated = CLASS_OF_NUMBER.get(str(number), prior.name)
            return simulated if simulated in prior.labels else prior.name
    return str(number)


def name_of_number(number: int, classes: Sequence[ClassPrior]) -> str:
    """The name in ROS 2 of a hypothesis of this number: of a count, or of a class."""
    return count_of(str(number)) or class_name_of_number(number, classes)


_AS_NUMBERED = partial(name_of_number, classes=())


@decoder
def to_ros2(
    message: RawMessage, name_of: Callable[[int], str] = _AS_NUMBERED, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> RawMessage:
    """The message as CDR, with the definition that its channel needs in a file; times and order are kept.

    `name_of` gives the names of the numbers in ROS 1's vision_msgs.
    """
    channel = message.channel
    if message.problem:
        raise MessageError(f"{channel.topic}: {message.problem}")
    if channel.encoding == "cdr":
        return message._replace(channel=_defined(channel))
    if channel.encoding != "ros1":
        raise MessageError(f"{channel.topic}: {channel.msgtype} in {channel.encoding} is not a ROS message")
    recorded = deserialize(message, limits=limits)
    if channel.msgtype in VISION_ARRAYS:
        converted = _vision_message(recorded, channel.msgtype, name_of)
        in_ros2 = _as_cdr(channel, channel.msgtype, ROS2.definition(channel.msgtype))
        return message._replace(channel=in_ros2, data=ROS2.serialize(converted))
    store, in_ros2, fits = _in_ros2(channel)
    if fits:
        return message._replace(channel=in_ros2, data=store.serialize_cdr(recorded, in_ros2.msgtype))
    from rosbags.convert.converter import migrate_message  # 0.1 s: it brings the readers and writers of all bags

    moved: Any = migrate_message(typestore_for(channel), store, channel.msgtype, in_ros2.msgtype, {}, recorded)
    return message._replace(channel=in_ros2, data=store.serialize_cdr(moved, in_ros2.msgtype))


@lru_cache(maxsize=1024)
def _as_cdr(channel: Channel, msgtype: str, definition: str) -> Channel:
    return replace(
        channel, msgtype=msgtype, encoding="cdr", definition=definition, definition_format="ros2msg", digest=""
    )


@lru_cache(maxsize=1024)
def _defined(channel: Channel) -> Channel:
    """The channel with the definition that it was recorded with, or that of its release if it was recorded without."""
    if channel.definition.strip():
        return channel
    definition, _ = typestore_for(channel).generate_msgdef(channel.msgtype, ros_version=2)
    return replace(channel, definition=definition, definition_format="ros2msg")


@lru_cache(maxsize=1024)
def _in_ros2(channel: Channel) -> tuple[Typestore, Channel, bool]:
    """The types of ROS 2 for a ROS 1 channel, and the channel that has them.

    Also whether recorded messages can be written as they are: the type has no other name, and all fields are recorded.
    """
    recorded = typestore_for(channel).fielddefs
    msgtype = RENAMED.get(channel.msgtype, channel.msgtype)
    types: Typesdict = {}
    wanted = [(channel.msgtype, msgtype)]
    while wanted:
        name, renamed = wanted.pop()
        if renamed in types:
            continue
        humble = known_type(renamed)
        # A type that is new in ROS 2, as in a new field of a marker, is not recorded.
        types[renamed] = humble if name not in recorded or _holds(humble, renamed, recorded[name]) else recorded[name]
        wanted += [(part, part) for part in type_parts(types[renamed][1])]
    store = get_typestore(Stores.EMPTY)
    store.register({name: definition for name, definition in types.items() if name not in store.fielddefs})
    definition, _ = store.generate_msgdef(msgtype, ros_version=2)
    in_ros2 = _as_cdr(channel, msgtype, definition)
    fits = msgtype == channel.msgtype and all(
        name in recorded and field in recorded[name][1] for name in types for field in store.fielddefs[name][1]
    )
    return store, in_ros2, fits


def _holds(humble: Any, name: str, recorded: Any) -> bool:
    """Whether Humble's definition of a type has every field of the recorded one; the case of names may differ."""
    if humble is None or name == HEADER:
        return humble is not None
    fields = {field.lower(): kind for field, kind in humble[1]}
    return all(fields.get(field.lower()) == kind for field, kind in recorded[1])


def _vision_message(recorded: Any, msgtype: str, name_of: Callable[[int], str]) -> Any:
    """A Detection2DArray or Detection3DArray of ROS 2 from one of ROS 1."""
    convert: Callable[[Any], Any] = _box_3d if msgtype == _BOXES_3D else _box_2d
    element = msgtype.removesuffix("Array")
    detections = []
    for detection in recorded.detections:
        instances = [int(result.score) for result in detection.results if result.id == INSTANCE]
        detections.append(
            ROS2.new(
                element,
                header=_header(detection.header),
                results=[_hypothesis(result, name_of) for result in detection.results if result.id != INSTANCE],
                bbox=convert(detection.bbox),
                id=str(instances[0]) if instances and instances[0] >= 0 else "",
            )
        )
    return ROS2.new(msgtype, header=_header(recorded.header), detections=detections)


def _hypothesis(result: Any, name_of: Callable[[int], str]) -> Any:
    hypothesis = ROS2.new("vision_msgs/msg/ObjectHypothesis", class_id=name_of(result.id), score=result.score)
    pose = ROS2.pose_with_covariance(_pose(result.pose.pose), result.pose.covariance)
    return ROS2.new("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=pose)


def _box_3d(bbox: Any) -> Any:
    size = ROS2.vector(bbox.size.x, bbox.size.y, bbox.size.z)
    return ROS2.new("vision_msgs/msg/BoundingBox3D", center=_pose(bbox.center), size=size)


def _box_2d(bbox: Any) -> Any:
    position = ROS2.new("vision_msgs/msg/Point2D", x=bbox.center.x, y=bbox.center.y)
    center = ROS2.new("vision_msgs/msg/Pose2D", position=position, theta=bbox.center.theta)
    return ROS2.new("vision_msgs/msg/BoundingBox2D", center=center, size_x=bbox.size_x, size_y=bbox.size_y)


def _header(recorded: Any) -> Any:
    stamp_ns = recorded.stamp.sec * 10**9 + recorded.stamp.nanosec
    return ROS2.header(stamp_ns, recorded.frame_id)


def _pose(recorded: Any) -> Any:
    return ROS2.pose(*pose_numbers(recorded))
