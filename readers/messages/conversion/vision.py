"""Arrays of boxes of ROS 1's vision_msgs in the layout of ROS 2 Humble.

ROS 1 numbers classes where ROS 2 names them, and has no field for whose box it is. The simulator therefore records
counts and the instance as hypotheses with negative numbers (docs/simulator.md); in ROS 2 these are hypotheses with
names, and the instance is `id`. The empty `source_cloud` and `source_img` of ROS 1 have no place in ROS 2.
"""

from collections.abc import Callable, Sequence
from typing import Any

from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.vision_numbers import CLASS_OF_NUMBER, COUNT_NUMBERS, count_of
from pipeline.core.settings.classes import ClassPrior

__all__ = ["INSTANCE", "VISION_ARRAYS", "class_name_of_number", "name_of_number", "vision_message"]

_BOXES_3D, _BOXES_2D = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"

VISION_ARRAYS = frozenset({_BOXES_2D, _BOXES_3D})

INSTANCE = COUNT_NUMBERS["instance"]
"""Of a hypothesis whose score says which object it is."""


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
    """What a hypothesis of this number is in ROS 2: what it counts, or its class."""
    return count_of(str(number)) or class_name_of_number(number, classes)


def vision_message(recorded: Any, msgtype: str, name_of: Callable[[int], str]) -> Any:
    """A Detection2DArray or Detection3DArray of ROS 2 from one of ROS 1.

    Args:
        recorded: The message of ROS 1.
        msgtype: Its type, one of `VISION_ARRAYS`.
        name_of: `name_of_number` of some classes.
    """
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
    position, orientation = recorded.position, recorded.orientation
    return ROS2.pose((position.x, position.y, position.z), (orientation.x, orientation.y, orientation.z, orientation.w))
