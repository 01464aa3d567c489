"""Messages of 3D objects as detectors record them, in every layout that lidcam reads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import builders
import numpy as np
from builders import Fields, header, serialize
from message_layouts import message_of_layout

from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.core.ros.vision_numbers import CLASS_NUMBERS

Format = Literal["ros1", "foxy", "galactic", "humble", "autoware", "autoware_auto"]
FORMATS: tuple[Format, ...] = ("ros1", "foxy", "galactic", "humble", "autoware", "autoware_auto")

DETECTIONS_3D = "vision_msgs/msg/Detection3DArray"
AUTOWARE_NUMBERS = {"unknown": 0, "car": 1, "truck": 2, "bus": 3, "motorcycle": 5, "bicycle": 6, "pedestrian": 7}

_POSED = "geometry_msgs/PoseWithCovariance pose"
_OLD = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/ObjectHypothesisWithPose": f"string id\nfloat64 score\n{_POSED}",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
        "bool is_tracking\nstring tracking_id"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}
_GALACTIC = {
    **_OLD,
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": f"ObjectHypothesis hypothesis\n{_POSED}",
}


@dataclass(frozen=True)
class Recorded:
    """An object as a detector sees it."""

    center: Sequence[float]
    label: str = "car"
    score: float = 0.75
    size: Sequence[float] = (4.0, 2.0, 1.5)
    xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    covariance: Any = None

    @property
    def pose(self) -> Fields:
        """geometry_msgs/Pose."""
        return builders.pose(self.center, self.xyzw)

    @property
    def posed(self) -> Fields:
        """geometry_msgs/PoseWithCovariance."""
        covariance = np.zeros((6, 6)) if self.covariance is None else np.asarray(self.covariance, np.float64)
        return {"pose": self.pose, "covariance": covariance.reshape(36)}


def objects_message(format_: Format, stamp_ns: int, objects: Sequence[Recorded], **options: Any) -> RawMessage:
    """A message of objects in one of the formats; options `frame_id`, `topic` and `log_time_ns`."""
    if format_ in ("autoware", "autoware_auto"):
        package = f"{format_}_perception_msgs"
        return autoware_message(stamp_ns, [autoware_object(one) for one in objects], package=package, **options)
    return boxes_message(format_, stamp_ns, objects, **options)


def boxes_message(
    format_: Format,
    stamp_ns: int,
    objects: Sequence[Recorded],
    *,
    frame_id: str = "site",
    topic: str = "/detector/objects",
    log_time_ns: int | None = None,
) -> RawMessage:
    """A vision_msgs/Detection3DArray; in ROS 1 with the predecessor's and the simulator's numbers as classes."""
    body = {"header": header(stamp_ns, frame_id), "detections": [_detection(format_, one) for one in objects]}
    if format_ == "foxy":
        message = message_of_layout(DETECTIONS_3D, _OLD, "cdr", body, topic=topic, stamp_ns=stamp_ns)
    elif format_ == "galactic":
        message = message_of_layout(DETECTIONS_3D, _GALACTIC, "cdr", body, topic=topic, stamp_ns=stamp_ns)
    elif format_ == "ros1":
        message = builders.raw(topic, DETECTIONS_3D, body, stamp_ns, encoding="ros1", store=message_types(1))
    else:
        message = builders.raw(topic, DETECTIONS_3D, body, stamp_ns)
    return message._replace(log_time_ns=stamp_ns if log_time_ns is None else log_time_ns)


def _detection(format_: Format, one: Recorded) -> Fields:
    size = dict(zip("xyz", map(float, one.size), strict=True))
    known: Mapping[str, Any]
    if format_ == "ros1":
        known = {"id": CLASS_NUMBERS.get(one.label, 77), "score": one.score, "pose": one.posed}
    elif format_ == "foxy":
        known = {"id": one.label, "score": one.score, "pose": one.posed}
    else:
        known = {"hypothesis": {"class_id": one.label, "score": one.score}, "pose": one.posed}
    return {"results": [known], "bbox": {"center": one.pose, "size": size}}


def autoware_object(one: Recorded, **changed: Any) -> dict[str, Any]:
    """An autoware_perception_msgs/DetectedObject; `changed` are fields of its kinematics or shape."""
    kinematics = {"pose_with_covariance": one.posed, "has_position_covariance": True, "orientation_availability": 2}
    shape = {"type": 0, "dimensions": dict(zip("xyz", map(float, one.size), strict=True))}
    kinematics |= {key: value for key, value in changed.items() if key in kinematics}
    shape |= {key: value for key, value in changed.items() if key in ("type", "footprint")}
    return {
        "existence_probability": one.score,
        "classification": [{"label": AUTOWARE_NUMBERS.get(one.label, 77), "probability": 1.0}],
        "kinematics": kinematics,
        "shape": shape,
    }


def autoware_message(
    stamp_ns: int,
    objects: Sequence[Fields],
    *,
    package: str = "autoware_perception_msgs",
    frame_id: str = "site",
    topic: str = "/detector/objects",
    log_time_ns: int | None = None,
) -> RawMessage:
    """A DetectedObjects, with its definition."""
    store = message_types(2)
    body = {"header": header(stamp_ns, frame_id), "objects": list(objects)}
    msgtype = "autoware_perception_msgs/msg/DetectedObjects"
    definition, _ = store.generate_msgdef(msgtype, ros_version=2)
    definition = definition.replace("autoware_perception_msgs", package)
    channel = Channel(topic, msgtype.replace("autoware_perception_msgs", package), "cdr", definition)
    data = serialize(msgtype, body, "cdr", store)
    return RawMessage(stamp_ns, stamp_ns if log_time_ns is None else log_time_ns, (0, 0), data, channel)
