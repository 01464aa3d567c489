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

from lidcam.pipeline.core.arrays import F32, F64, Bools, Names
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.messages.vision.hypotheses import best_and_counts, box_rows

DETECTIONS_2D = "vision_msgs/msg/Detection2DArray"


class Detections2D(NamedTuple):
    """The boxes of one message."""

    boxes: Boxes2D  # Boxes of known classes, in recorded order
    labels: Names  # (N,) str, classes as recorded; a number as text in ROS 1
    ids: Names  # (N,) str, what the message calls each box; empty where it says nothing, as in ROS 1
    # (N,) float64 by name, hypotheses that count something (see `count_of`); NaN where a box has no such
    counts: Mapping[str, F64]
    unused: Mapping[str, int]  # Number of other detections by reason, sorted by reason


@decoder
def decode_detections2d(
    message: RawMessage,
    class_id_of_label: Mapping[str, int],
    *,
    class_names: Sequence[str] = (),
    other_class_id: int | None = None,
    limits: RecordingLimits = DEFAULT_LIMITS,
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
    rows = box_rows(message, DETECTIONS_2D, _numbers, 5, limits)
    best, counts = best_and_counts(rows)
    xyxy, has_area = _hulls(rows.boxes)
    kept: list[int] = []
    ids: list[int] = []
    unused: Counter[str] = Counter()
    for row, hypothesis in enumerate(best.tolist()):
        if hypothesis < 0:
            unused["no class with a score"] += 1
            continue
        label = rows.labels[hypothesis].strip()
        class_id = class_ids.get(_name_of(label, class_ids, class_names), other_class_id)
        if class_id is None:
            unused[f"class {label!r} is not configured"] += 1
        elif not has_area[row]:
            unused["box without an area or not finite"] += 1
        else:
            kept.append(row)
            ids.append(class_id)
    at = np.array(kept, np.intp)
    scores = np.clip(rows.scores[best[at]], 0.0, 1.0).astype(np.float32)
    boxes = Boxes2D(message.stamp_ns, clean_frame(rows.frame_id), xyxy[at], scores, np.array(ids, np.int32))
    return Detections2D(
        boxes,
        np.array([rows.labels[row].strip() for row in best[at].tolist()], np.str_),
        np.array([rows.ids[row] for row in kept], np.str_),
        {name: values[at] for name, values in counts.items()},
        dict(sorted(unused.items())),
    )


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
