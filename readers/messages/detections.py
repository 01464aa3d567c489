"""Decodes vision_msgs/Detection2DArray and Detection3DArray of all versions.

The layout changed several times; the recorded definition says which one a message has:

| vision_msgs | class | score | identity in space | centre of a 2D box |
| --- | --- | --- | --- | --- |
| ROS 1 | results[].id (int64) | results[].score | none; in ours the count `instance` | bbox.center.x, .y |
| ROS 2 to Foxy | results[].id (string) | results[].score | tracking_id | bbox.center.x, .y |
| ROS 2 Galactic | results[].hypothesis.class_id | results[].hypothesis.score | tracking_id or id | bbox.center.x, .y |
| since Humble | results[].hypothesis.class_id | results[].hypothesis.score | id | bbox.center.position.x, .y |
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from typing import Any, ClassVar, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Indices, Names, Table, check_array
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.vision_numbers import MAX_DIGITS, count_of
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as, pose_numbers
from lidcam.readers.messages.objects import FoundObjects, ObjectClasses, check_boxes, found_objects
from lidcam.readers.messages.tf import clean_frame

_NO_COVARIANCE = np.zeros(36)


class BoxRows(NamedTuple):
    """The content of an array of boxes, as recorded."""

    frame_id: str  # As recorded
    # (N, 10) float64 in space: position x, y, z; orientation x, y, z, w; size x, y, z. (N, 5) in images: centre x, y;
    # angle; size x, y
    boxes: F64
    ids: list[str]  # Of each box
    of_box: list[int]  # Row of the box of each hypothesis
    labels: list[str]  # Class of each hypothesis; a number as text
    scores: F64  # (H,) float64
    covariances: F64  # (H, 36) float64, of each hypothesis' pose


def box_rows(
    message: RawMessage, msgtype: str, box_of: Callable[[Any], Sequence[float]], numbers: int, limits: RecordingLimits
) -> BoxRows:
    """The content of an array of boxes: of each the `numbers` that `box_of` takes from its decoded `bbox`."""
    array = deserialize_as(message, msgtype, limits=limits)
    check_boxes(array.detections, message.topic, limits)
    results = [(row, result) for row, detection in enumerate(array.detections) for result in detection.results]
    hypotheses = [getattr(result, "hypothesis", result) for _, result in results]
    covariances = [_covariance(result) for _, result in results]
    boxes = np.array([box_of(detection.bbox) for detection in array.detections], np.float64).reshape(-1, numbers)
    return BoxRows(
        array.header.frame_id,
        boxes,
        [str(getattr(one, "id", "") or getattr(one, "tracking_id", "")) for one in array.detections],
        [row for row, _ in results],
        [str(one.class_id if hasattr(one, "class_id") else one.id) for one in hypotheses],
        np.array([one.score for one in hypotheses], np.float64),
        np.array(covariances, np.float64).reshape(-1, 36),
    )


def _covariance(result: Any) -> F64:
    """(36,) of a hypothesis' pose; zeros where the layout has none, as it may in images."""
    found = np.asarray(getattr(getattr(result, "pose", None), "covariance", _NO_COVARIANCE), np.float64)
    return found if found.shape == _NO_COVARIANCE.shape else _NO_COVARIANCE


def best_and_counts(rows: BoxRows) -> tuple[Indices, dict[str, F64]]:
    """The best hypothesis of each box, and what the others count.

    Returns:
        (N,) row of the hypothesis with the highest score that is a class, of equal ones the first, -1 without one; and
        (N,) float64 by what is counted (see `count_of`), NaN where a box has no such hypothesis. Scores that are not
        finite say nothing.
    """
    n = len(rows.boxes)
    best, highest = [-1] * n, [-math.inf] * n
    counts: dict[str, F64] = {}
    for row, (box, label, score) in enumerate(zip(rows.of_box, rows.labels, rows.scores.tolist(), strict=True)):
        if not math.isfinite(score):
            continue
        if name := count_of(label.strip()):
            if name not in counts:
                counts[name] = np.full(n, np.nan)
            counts[name][box] = score
        elif score > highest[box]:
            best[box], highest[box] = row, score
    return np.array(best, np.intp), counts


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
    classes: ObjectClasses,
    *,
    other_class_id: int | None = None,
    limits: RecordingLimits = DEFAULT_LIMITS,
) -> Detections2D:
    """The boxes of a message, each with the class of its best hypothesis (of equal scores the first).

    Hypotheses that count something are no classes (see `count_of`). Rotated boxes (`theta`) become their upright hull.
    Scores are clipped to [0, 1]. Boxes of none of the `classes` get `other_class_id`; without one they are not used.
    """
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
        class_id = classes.id_of(label)
        class_id = other_class_id if class_id is None else class_id
        if class_id is None:
            unused[f"class {one_line(label, max_characters=40)!r} is not configured"] += 1
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


_OF_NAMES = 1 << 62
"""Set in the numbers of ids that are names, so that no recorded number is one of them."""


def track_ids(ids: Names) -> I64:
    """(N,) the numbers of ids: a number is itself, a name gets one of its own; `UNKNOWN` where the id is empty."""
    return np.array([_track_id(id_) for id_ in ids.tolist()], np.int64).reshape(-1)


@lru_cache(maxsize=65_536)
def _track_id(id_: str) -> int:
    if not id_:
        return UNKNOWN
    if id_.isascii() and id_.isdecimal() and len(id_) <= MAX_DIGITS:
        return int(id_)
    digest = int.from_bytes(blake2b(id_.encode(errors="replace"), digest_size=8).digest(), "big")
    return digest % _OF_NAMES | _OF_NAMES


DETECTIONS_3D = "vision_msgs/msg/Detection3DArray"

MAX_M = 1e15
"""Numbers beyond this overflow in volumes and images."""

MIN_HEADING = 1e-3
"""Shortest projection of a box's length axis (of length 1) on the ground that still has a heading."""

_X_Y_YAW = np.array([0, 1, 5])
"""Rows of the 6 x 6 covariance of a pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Detections3D(Table):
    """The boxes of one message, in recorded order."""

    ROWS: ClassVar = {"centers": (3,), "sizes": (3,), "covariances": (3, 3)}

    stamp_ns: int  # Stamp of the message
    frame_id: str  # Frame of `centers`
    centers: F64  # (N, 3) float64, centre of the box, metres
    sizes: F64  # (N, 3) float64, length, width, height, metres
    yaws: F64  # (N,) float64, heading of the box's length about +z, in (-pi, pi]; of a tilted box, of its projection
    covariances: F64  # (N, 3, 3) float64 over x, y (m^2) and yaw (rad^2), of the best hypothesis
    scores: F32  # (N,) float32 in [0, 1], of the best hypothesis; 0 without one
    labels: Names  # (N,) str, class of the best hypothesis, a number as text in ROS 1; empty without one
    ids: Names  # (N,) str, the same for the same object in all messages; empty where the message has none
    # (N,) float64 by name, hypotheses that count something (see `count_of`); NaN where a box has no such
    counts: Mapping[str, F64]
    unused: Mapping[str, int]  # Number of other boxes by reason, sorted by reason

    def __post_init__(self) -> None:
        self.check_rows()
        for name, values in self.counts.items():
            check_array(name, values, (len(self),), np.float64)


@decoder
def decode_detections3d(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Detections3D:
    """The boxes of a message, each with the class of its best hypothesis (of equal scores the first)."""
    rows = box_rows(message, DETECTIONS_3D, _box_numbers, 10, limits)
    best, counts = best_and_counts(rows)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z, w = rows.boxes[:, 3:7].T
        along, across = w * w + x * x - y * y - z * z, 2 * (w * z + x * y)
        turn = x * x + y * y + z * z + w * w
        is_turned = np.isfinite(turn) & (turn > 0) & (np.hypot(along, across) > MIN_HEADING * turn)
        sizes = rows.boxes[:, 7:]
        is_solid = (np.abs(rows.boxes[:, :3]) <= MAX_M).all(1) & ((sizes > 0) & (sizes <= MAX_M)).all(1)
        yaws = np.arctan2(across, along)
    unused = Counter[str]()
    unused["box without a volume or not finite"] = int((~is_solid).sum())
    unused["box without a heading"] = int((is_solid & ~is_turned).sum())
    kept = np.flatnonzero(is_solid & is_turned)
    has_best = best[kept] >= 0
    covariances = np.zeros((len(kept), 3, 3))
    covariances[has_best] = rows.covariances[best[kept][has_best]].reshape(-1, 6, 6)[:, _X_Y_YAW[:, None], _X_Y_YAW]
    scores = np.zeros(len(kept), np.float32)
    scores[has_best] = np.clip(rows.scores[best[kept][has_best]], 0, 1)
    yaws = yaws[kept]
    yaws[yaws <= -np.pi] = np.pi
    return Detections3D(
        message.stamp_ns,
        clean_frame(rows.frame_id),
        rows.boxes[kept, :3],
        sizes[kept],
        yaws,
        covariances,
        scores,
        np.array([rows.labels[row].strip() if row >= 0 else "" for row in best[kept].tolist()], np.str_),
        np.array([rows.ids[row] for row in kept.tolist()], np.str_),
        {name: values[kept] for name, values in counts.items()},
        {reason: count for reason, count in sorted(unused.items()) if count},
    )


@decoder
def decode_detected_boxes(
    message: RawMessage, classes: ObjectClasses, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> FoundObjects:
    """The objects of a message, each with the class, score and covariance of its best hypothesis."""
    rows = box_rows(message, DETECTIONS_3D, _box_numbers, 10, limits)
    best, _ = best_and_counts(rows)
    has_best = best >= 0
    covariances, scores = np.zeros((len(best), 36)), np.full(len(best), np.nan)
    covariances[has_best], scores[has_best] = rows.covariances[best[has_best]], rows.scores[best[has_best]]
    labels = [rows.labels[row] if row >= 0 else None for row in best.tolist()]
    return found_objects(message.stamp_ns, rows.frame_id, rows.boxes, covariances, scores, labels, classes)


def _box_numbers(bbox: Any) -> list[float]:
    """The numbers of a box in the order of `BoxRows.boxes`."""
    position, orientation = pose_numbers(bbox.center)
    return [*position, *orientation, bbox.size.x, bbox.size.y, bbox.size.z]
