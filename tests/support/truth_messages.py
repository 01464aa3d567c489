"""Messages of truth, as recorded."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from builders import Encoding, Fields, box2d, header, pose, raw

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.core.ros.vision_numbers import CLASS_NUMBERS, COUNT_NUMBERS

DETECTIONS_3D = "vision_msgs/msg/Detection3DArray"


def true_object(
    label: str,
    center: Sequence[float],
    *,
    size: Sequence[float] = (4.0, 2.0, 1.5),
    yaw: float = 0.0,
    name: str = "",
    counts: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """One object of `truth_message`."""
    return {"label": label, "center": center, "size": size, "yaw": yaw, "name": name, "counts": counts or {}}


def truth_message(
    stamp_ns: int,
    objects: Sequence[Mapping[str, Any]],
    *,
    frame_id: str = "site",
    topic: str = "/ground_truth/objects",
    log_time_ns: int | None = None,
    encoding: Encoding = "cdr",
) -> RawMessage:
    """A Detection3DArray of `true_object`s; in ROS 1 with numbers as classes, and the name's digits as the instance."""
    body = {
        "header": header(stamp_ns, frame_id),
        "detections": [_ros1(one) if encoding == "ros1" else _ros2(one) for one in objects],
    }
    store = message_types(1) if encoding == "ros1" else None
    return raw(topic, DETECTIONS_3D, body, stamp_ns, log_time_ns, encoding, store=store)


def visible_message(
    stamp_ns: int,
    boxes: Sequence[tuple[str, Sequence[float], str, float]],
    *,
    camera: str = "left",
    frame_id: str = "",
    log_time_ns: int | None = None,
) -> RawMessage:
    """A Detection2DArray of boxes (label, left top right bottom, name, pixels)."""
    detections = [
        {
            "results": [
                {"hypothesis": {"class_id": key, "score": score}}
                for key, score in ((label, 1.0), ("image_pixels", pixels), ("occlusion", 0.25))
            ],
            "bbox": box2d(*xyxy),
            "id": name,
        }
        for label, xyxy, name, pixels in boxes
    ]
    body = {"header": header(stamp_ns, frame_id or camera), "detections": detections}
    topic = f"/ground_truth/{camera}/visible"
    return raw(topic, "vision_msgs/msg/Detection2DArray", body, stamp_ns, log_time_ns)


def _box(one: Mapping[str, Any]) -> Fields:
    center = pose(one["center"], (0, 0, math.sin(one["yaw"] / 2), math.cos(one["yaw"] / 2)))
    return {"center": center, "size": dict(zip("xyz", map(float, one["size"]), strict=True))}


def _ros2(one: Mapping[str, Any]) -> Fields:
    scores = {one["label"]: 1.0, **one["counts"]}
    results = [{"hypothesis": {"class_id": key, "score": float(score)}} for key, score in scores.items()]
    return {"results": results, "bbox": _box(one), "id": one["name"]}


def _ros1(one: Mapping[str, Any]) -> Fields:
    numbers = {CLASS_NUMBERS[one["label"]]: 1.0, **{COUNT_NUMBERS[key]: score for key, score in one["counts"].items()}}
    if one["name"]:
        numbers[COUNT_NUMBERS["instance"]] = float(one["name"])
    return {"results": [{"id": key, "score": float(score)} for key, score in numbers.items()], "bbox": _box(one)}
