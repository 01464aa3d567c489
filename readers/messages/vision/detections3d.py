"""Decodes vision_msgs/Detection3DArray of all versions.

The layout changed several times; the recorded definition says which one a message has:

| vision_msgs | class | score | identity of the object |
| --- | --- | --- | --- |
| ROS 1 | results[].id (int64) | results[].score | none; in lidcam's recordings the count `instance` |
| ROS 2 to Foxy | results[].id (string) | results[].score | tracking_id |
| ROS 2 Galactic | results[].hypothesis.class_id | results[].hypothesis.score | tracking_id or id |
| ROS 2 since Humble | results[].hypothesis.class_id | results[].hypothesis.score | id |
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from typing import Any, ClassVar

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Names, Table, check_array
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.objects.found import FoundObjects, ObjectClasses, found_objects
from lidcam.readers.messages.tf import clean_frame
from lidcam.readers.messages.vision.hypotheses import BoxRows, best_and_counts, box_rows

_MAX_DIGITS = 18
_OF_NAMES = 1 << 62
"""Set in the numbers of ids that are names, so that no recorded number is one of them."""


def track_ids(ids: Names) -> I64:
    """(N,) the numbers of ids: a number is itself, a name gets one of its own; `UNKNOWN` where the id is empty."""
    return np.array([_track_id(id_) for id_ in ids.tolist()], np.int64).reshape(-1)


@lru_cache(maxsize=65_536)
def _track_id(id_: str) -> int:
    if not id_:
        return UNKNOWN
    if id_.isascii() and id_.isdecimal() and len(id_) <= _MAX_DIGITS:
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
    """The boxes of a message, each with the class of its best hypothesis (of equal scores the first).

    Raises:
        MessageError: not a Detection3DArray of a known layout, or more boxes than `limits` allow.
    """
    return _detections(message.stamp_ns, box_rows(message, DETECTIONS_3D, _box_numbers, 10, limits))


@decoder
def decode_detected_boxes(
    message: RawMessage, classes: ObjectClasses, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> FoundObjects:
    """The objects of a message, each with the class, score and covariance of its best hypothesis.

    Raises:
        MessageError: not a Detection3DArray of a known layout, or more boxes than `limits` allow.
    """
    rows = box_rows(message, DETECTIONS_3D, _box_numbers, 10, limits)
    best, _ = best_and_counts(rows)
    has_best = best >= 0
    covariances, scores = np.zeros((len(best), 36)), np.full(len(best), np.nan)
    covariances[has_best], scores[has_best] = rows.covariances[best[has_best]], rows.scores[best[has_best]]
    labels = [rows.labels[row] if row >= 0 else None for row in best.tolist()]
    return found_objects(message.stamp_ns, rows.frame_id, rows.boxes, covariances, scores, labels, classes)


def _box_numbers(bbox: Any) -> list[float]:
    """The numbers of a box in the order of `BoxRows.boxes`."""
    at, turn, size = bbox.center.position, bbox.center.orientation, bbox.size
    return [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w, size.x, size.y, size.z]


def _detections(stamp_ns: int, rows: BoxRows) -> Detections3D:
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
        stamp_ns,
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
