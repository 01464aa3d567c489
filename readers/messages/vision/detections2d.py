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
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes2D
from pipeline.core.errors import MessageError
from pipeline.core.messages import RawMessage
from pipeline.core.ros.vision_numbers import count_of
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from pipeline.evaluation.records import Names
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
        labels: (N,) str, classes as recorded; a number as text in ROS 1.
        ids: (N,) str, what the message calls each box; empty where it says nothing, as in ROS 1.
        counts: (N,) float64 by name, hypotheses that count something (see `count_of`); NaN where a box has no such.
        unused: Number of other detections by reason, sorted by reason.
    """

    boxes: Boxes2D
    labels: Names
    ids: Names
    counts: Mapping[str, F64]
    unused: Mapping[str, int]


@decoder
def decode_detections2d(
    message: RawMessage,
    class_id_of_label: Mapping[str, int],
    *,
    class_names: Sequence[str] = (),
    other_class_id: int | None = None,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Detections2D:
    """The boxes of a message, each with the class of its best hypothesis (of equal scores the first).

    Hypotheses that count something are no classes (see `count_of`). Classes are looked up by label, ignoring case. A
    number that is not a label is a row of `class_names`, the numbering of the detector that wrote it. Rotated boxes
    (`theta`) become their upright hull. Scores are clipped to [0, 1].

    Args:
        message: Detection2DArray of any version.
        class_id_of_label: Class id by each name that a detector may use.
        class_names: Labels of a detector that records numbers.
        other_class_id: Class id of boxes of any other class; None: they are not used.
        limits: How many boxes a message may hold.

    Raises:
        MessageError: not a Detection2DArray of a known layout, or more boxes than `limits` allow.
    """
    array = deserialize_as(message, DETECTIONS_2D, limits=limits)
    class_ids = {label.strip().lower(): class_id for label, class_id in class_id_of_label.items()}
    rows: list[_Row] = []
    unused: Counter[str] = Counter()
    if len(array.detections) > limits.max_boxes:
        raise MessageError(
            f"{message.topic}: {len(array.detections)} boxes, expected at most {limits.max_boxes}: raise "
            "limits.max_boxes"
        )
    for detection in array.detections:
        found = _read(detection, class_ids, class_names, other_class_id)
        if isinstance(found, str):
            unused[found] += 1
        else:
            rows.append(found)
    boxes = Boxes2D(
        message.stamp_ns,
        clean_frame(array.header.frame_id),
        np.array([row.xyxy for row in rows], np.float32).reshape(-1, 4),
        np.array([row.score for row in rows], np.float32),
        np.array([row.class_id for row in rows], np.int32),
    )
    names = sorted({name for row in rows for name in row.counts})
    return Detections2D(
        boxes,
        np.array([row.label for row in rows], np.str_),
        np.array([row.id for row in rows], np.str_),
        {name: np.array([row.counts.get(name, math.nan) for row in rows], np.float64) for name in names},
        dict(sorted(unused.items())),
    )


class _Row(NamedTuple):
    """One box, by the attributes of `Detections2D`."""

    xyxy: list[float]
    score: float
    class_id: int
    label: str
    id: str
    counts: Mapping[str, float]


def _read(
    detection: Any, class_ids: Mapping[str, int], class_names: Sequence[str], other_class_id: int | None
) -> _Row | str:
    """The box, or why the detection is not used."""
    best, highest = "", -math.inf
    counts: dict[str, float] = {}
    for result in detection.results:
        hypothesis = getattr(result, "hypothesis", result)
        label = str(hypothesis.class_id if hasattr(hypothesis, "class_id") else hypothesis.id).strip()
        score = float(hypothesis.score)
        if not math.isfinite(score):
            continue
        if name := count_of(label):
            counts[name] = score
        elif score > highest:
            best, highest = label, score
    if highest == -math.inf:
        return "no class with a score"
    class_id = class_ids.get(_name_of(best, class_ids, class_names), other_class_id)
    if class_id is None:
        return f"class {best!r} is not configured"
    xyxy = _hull(detection.bbox)
    if xyxy is None:
        return "box without an area or not finite"
    id_ = str(getattr(detection, "id", "") or getattr(detection, "tracking_id", ""))
    return _Row(xyxy, min(max(highest, 0.0), 1.0), class_id, best, id_, counts)


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
