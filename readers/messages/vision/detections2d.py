"""Decodes vision_msgs/Detection2DArray of all versions.

The layout changed several times; the recorded definition says which one a message has:

| vision_msgs | class | score | centre of the box |
| --- | --- | --- | --- |
| ROS 1 | results[].id (int64) | results[].score | bbox.center.x, .y (geometry_msgs/Pose2D) |
| ROS 2 to Foxy | results[].id (string) | results[].score | bbox.center.x, .y |
| ROS 2 Galactic | results[].hypothesis.class_id | results[].hypothesis.score | bbox.center.x, .y |
| ROS 2 since Humble | results[].hypothesis.class_id | results[].hypothesis.score | bbox.center.position.x, .y |
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import F32, F64, I32, Bools, Indices
from pipeline.core.detections import Boxes2D
from pipeline.core.messages import RawMessage
from pipeline.core.settings.recording import DEFAULT_LIMITS, LimitsConfig
from pipeline.evaluation.evaluation_frame import Names
from readers.messages.boundary.decoding import decoder
from readers.messages.tf import clean_frame
from readers.messages.vision.hypotheses import BoxRows, best_and_counts, box_rows

__all__ = [
    "DETECTIONS_2D",
    "ClassedBoxes",
    "Detections2D",
    "boxes_with_area",
    "decode_classed_boxes",
    "decode_detections2d",
    "unused_boxes",
]

DETECTIONS_2D = "vision_msgs/msg/Detection2DArray"


class Detections2D(NamedTuple):
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


class ClassedBoxes(NamedTuple):
    """The boxes of one message that are of known classes; which of them have an area is not known yet.

    Attributes:
        stamp_ns: Stamp of the message.
        frame_id: Frame of its header.
        rows: Its content.
        of_rows: (N,) row of each box.
        best: (N,) row of its best hypothesis.
        class_ids: (N,) int32, its class.
        counts: As of `Detections2D`, of all boxes of the message.
        unused: Number of boxes by reason, of the others.
    """

    stamp_ns: int
    frame_id: str
    rows: BoxRows
    of_rows: Indices
    best: Indices
    class_ids: I32
    counts: Mapping[str, F64]
    unused: Counter[str]


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
    class_ids = {label.strip().lower(): class_id for label, class_id in class_id_of_label.items()}
    found = decode_classed_boxes(
        message, class_ids, class_names=class_names, other_class_id=other_class_id, limits=limits
    )
    ((boxes, has_area),) = boxes_with_area([found])
    rows, at, best = found.rows, found.of_rows[has_area], found.best[has_area]
    return Detections2D(
        boxes,
        np.array([rows.labels[row].strip() for row in best.tolist()], np.str_),
        np.array([rows.ids[row] for row in at.tolist()], np.str_),
        {name: values[at] for name, values in found.counts.items()},
        dict(sorted(unused_boxes(found, boxes).items())),
    )


@decoder
def decode_classed_boxes(
    message: RawMessage,
    class_ids: Mapping[str, int],
    *,
    class_names: Sequence[str] = (),
    other_class_id: int | None = None,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> ClassedBoxes:
    """What `decode_detections2d` does with a single message; arguments as there, names in lower case and stripped."""
    rows = box_rows(message, DETECTIONS_2D, _numbers, 5, limits)
    best, counts = best_and_counts(rows)
    chosen: list[tuple[int, int, int]] = []
    unused: Counter[str] = Counter()
    for row, hypothesis in enumerate(best.tolist()):
        if hypothesis < 0:
            unused["no class with a score"] += 1
            continue
        label = rows.labels[hypothesis].strip()
        class_id = class_ids.get(_name_of(label, class_ids, class_names), other_class_id)
        if class_id is None:
            unused[f"class {label!r} is not configured"] += 1
        else:
            chosen.append((row, hypothesis, class_id))
    of_rows, of_best, of_class = np.array(chosen, np.int64).reshape(-1, 3).T
    frame_id = clean_frame(rows.frame_id)
    return ClassedBoxes(message.stamp_ns, frame_id, rows, of_rows, of_best, of_class.astype(np.int32), counts, unused)


def boxes_with_area(found: Sequence[ClassedBoxes]) -> list[tuple[Boxes2D, Bools]]:
    """Of each message the boxes that are finite and have an area, and which they are.

    A frame has messages of many cameras with a few boxes each, so they are looked at together.
    """
    if not found:
        return []
    xyxy, has_area = _hulls(np.concatenate([one.rows.boxes[one.of_rows] for one in found]))
    scores = np.concatenate([one.rows.scores[one.best] for one in found])
    scores = np.clip(scores, 0.0, 1.0).astype(np.float32)
    made, end = [], 0
    for one in found:
        part = slice(end, end := end + len(one.class_ids))
        kept = has_area[part]
        boxes = Boxes2D(one.stamp_ns, one.frame_id, xyxy[part][kept], scores[part][kept], one.class_ids[kept])
        made.append((boxes, kept))
    return made


def unused_boxes(found: ClassedBoxes, boxes: Boxes2D) -> Counter[str]:
    """Number of boxes of a message by reason, other than those with an area, which are given."""
    return +(found.unused + Counter({"box without an area or not finite": len(found.class_ids) - len(boxes)}))


def _name_of(label: str, class_ids: Mapping[str, int], class_names: Sequence[str]) -> str:
    if label.lower() not in class_ids and label.isdecimal() and int(label) < len(class_names):
        return class_names[int(label)].strip().lower()
    return label.lower()


def _numbers(bbox: Any) -> list[float]:
    """The numbers of a box in the order of `BoxRows.boxes`."""
    center = getattr(bbox.center, "position", bbox.center)
    return [center.x, center.y, bbox.center.theta, bbox.size_x, bbox.size_y]


def _hulls(boxes: F64) -> tuple[F32, Bools]:
    """Left, top, right, bottom in pixels (N, 4); and which of them are finite and have an area."""
    centers, theta, sizes = boxes[:, :2], boxes[:, 2], boxes[:, 3:]
    with np.errstate(over="ignore", invalid="ignore"):
        cos, sin = np.abs(np.cos(theta)), np.abs(np.sin(theta))
        half = np.stack([sizes[:, 0] * cos + sizes[:, 1] * sin, sizes[:, 0] * sin + sizes[:, 1] * cos], -1) / 2
        xyxy = np.concatenate([centers - half, centers + half], -1).astype(np.float32)
        is_right = np.hstack([sizes > 0, np.isfinite(xyxy), xyxy[:, :2] < xyxy[:, 2:]])
    return xyxy, np.asarray(is_right.all(1))
