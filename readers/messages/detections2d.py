"""Decodes vision_msgs/Detection2DArray of all versions.

The layout changed several times; the recorded definition says which one a message has:

| vision_msgs | class | score | centre of the box |
| --- | --- | --- | --- |
| ROS 1 | results[].id (int64) | results[].score | bbox.center.x, .y (geometry_msgs/Pose2D) |
| ROS 2 to Foxy | results[].id (string) | results[].score | bbox.center.x, .y |
| ROS 2 Galactic | results[].hypothesis.class_id | results[].hypothesis.score | bbox.center.x, .y |
| ROS 2 since Humble | results[].hypothesis.class_id | results[].hypothesis.score | bbox.center.position.x, .y |
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes2D
from pipeline.core.errors import MessageError
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from readers.messages.boundary.decoding import decoder
from readers.messages.deserialize import deserialize_as
from readers.messages.tf import clean_frame

__all__ = ["DETECTIONS_2D", "Detections2D", "decode_detections2d"]

DETECTIONS_2D = "vision_msgs/msg/Detection2DArray"


@dataclass(frozen=True, slots=True, eq=False)
class Detections2D:
    """The boxes of one message.

    Attributes:
        boxes: Boxes of known classes, in recorded order.
        unused: Number of other detections by reason, sorted by reason.
    """

    boxes: Boxes2D
    unused: Mapping[str, int]


@decoder
def decode_detections2d(
    message: RawMessage,
    class_id_of_label: Mapping[str, int],
    *,
    class_names: Sequence[str] = (),
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Detections2D:
    """The boxes of a message, each with the class of its best hypothesis (of equal scores the first).

    ROS 1's hypotheses with negative ids are no classes: lidcam's simulator has counts there. Classes are looked up by
    label, ignoring case. A number that is not a label is a row of `class_names`, the numbering
    of the detector that wrote it. Rotated boxes (`theta`) become their upright hull. Scores are clipped to [0, 1].

    Args:
        message: Detection2DArray of any version.
        class_id_of_label: Class id by each name that a detector may use.
        class_names: Labels of a detector that records numbers.
        limits: How many boxes a message may hold.

    Raises:
        MessageError: not a Detection2DArray of a known layout, or more boxes than `limits` allow.
    """
    array = deserialize_as(message, DETECTIONS_2D, limits=limits)
    class_ids = {label.strip().lower(): class_id for label, class_id in class_id_of_label.items()}
    rows: list[tuple[list[float], float, int]] = []
    unused: Counter[str] = Counter()
    if len(array.detections) > limits.max_boxes:
        raise MessageError(
            f"{message.topic}: {len(array.detections)} boxes, expected at most {limits.max_boxes}: raise "
            "limits.max_boxes"
        )
    for detection in array.detections:
        found = _read(detection, class_ids, class_names)
        if isinstance(found, str):
            unused[found] += 1
        else:
            rows.append(found)
    boxes = Boxes2D(
        message.stamp_ns,
        clean_frame(array.header.frame_id),
        np.array([xyxy for xyxy, _, _ in rows], np.float32).reshape(-1, 4),
        np.array([score for _, score, _ in rows], np.float32),
        np.array([class_id for _, _, class_id in rows], np.int32),
    )
    return Detections2D(boxes, dict(sorted(unused.items())))


def _read(
    detection: Any, class_ids: Mapping[str, int], class_names: Sequence[str]
) -> tuple[list[float], float, int] | str:
    """Left, top, right, bottom; score; class id. Or why the detection is not used."""
    hypotheses = [getattr(result, "hypothesis", result) for result in detection.results]
    scored = [one for one in hypotheses if math.isfinite(one.score) and not _is_negative(getattr(one, "id", 0))]
    if not scored:
        return "no class with a score"
    best = max(scored, key=lambda hypothesis: float(hypothesis.score))
    label = str(best.class_id if hasattr(best, "class_id") else best.id).strip()
    class_id = class_ids.get(_name_of(label, class_ids, class_names))
    if class_id is None:
        return f"class {label!r} is not configured"
    xyxy = _hull(detection.bbox)
    if xyxy is None:
        return "box without an area or not finite"
    return xyxy, min(max(float(best.score), 0.0), 1.0), class_id


def _is_negative(id: int | str) -> bool:
    return isinstance(id, int) and id < 0


def _name_of(label: str, class_ids: Mapping[str, int], class_names: Sequence[str]) -> str:
    if label.lower() not in class_ids and label.isdecimal() and int(label) < len(class_names):
        return class_names[int(label)].strip().lower()
    return label.lower()


def _hull(bbox: Any) -> list[float] | None:
    """Left, top, right, bottom in pixels; None if not finite or without an area."""
    center = getattr(bbox.center, "position", bbox.center)
    theta, size_x, size_y = bbox.center.theta, bbox.size_x, bbox.size_y
    if not (size_x > 0 and size_y > 0 and math.isfinite(theta)):
        return None
    cos, sin = abs(math.cos(theta)), abs(math.sin(theta))
    half_x, half_y = (size_x * cos + size_y * sin) / 2, (size_x * sin + size_y * cos) / 2
    xyxy = [center.x - half_x, center.y - half_y, center.x + half_x, center.y + half_y]
    with np.errstate(over="ignore"):
        left, top, right, bottom = np.array(xyxy, np.float32).tolist()
    finite = all(math.isfinite(edge) for edge in (left, top, right, bottom))
    return xyxy if finite and left < right and top < bottom else None
