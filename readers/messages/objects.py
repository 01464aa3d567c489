"""Messages of 3D objects: rows of numbers, labels and scores become boxes; Autoware's DetectedObjects; lidcam's tracks.

Of Autoware's DetectedObjects (autoware_perception_msgs, and its predecessor autoware_auto_perception_msgs), an object's
score is its `existence_probability`, its class that with the highest probability; classes are numbered. Cylinders
become boxes around them, polygons boxes around their footprint, along the axes of the object.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, Bools, CheckedTable
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.posed_boxes import PosedBoxes
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.pipeline.detectors.onnx.class_names import COCO_LABELS
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as, pose_numbers
from lidcam.readers.messages.tf import clean_frame

AUTOWARE_LABELS = (
    "unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "animal", "hazard",
    "over_drivable", "under_drivable",
)  # fmt: skip
"""autoware_perception_msgs/ObjectClassification, by number."""

MAX_M = 1e8
"""Coordinates beyond this are no place on Earth, not even in UTM."""


class FoundObjects(NamedTuple):
    """The usable objects of one message, in recorded order."""

    stamp_ns: int  # Stamp of the message
    frame_id: str  # Frame of the boxes; empty if the message names none
    boxes: PosedBoxes  # (N,) in that frame
    scores: F32  # (N,) float32 in [0, 1]
    class_ids: I32  # (N,) int32, row of the configured classes
    unused: Mapping[str, int]  # Number of other objects by reason, sorted by reason


class ObjectClasses:
    """The classes by what detectors call them; `numbering` is a `class_numbers` of the settings."""

    def __init__(
        self, class_id_of_label: Mapping[str, int], numbering: Literal["labels", "coco", "autoware"] = "labels"
    ) -> None:
        known = {label.strip().lower(): class_id for label, class_id in class_id_of_label.items()}
        self._ids = {label: row for label, row in known.items() if numbering == "labels" or not label.isdecimal()}
        self._numbered = {"labels": (), "coco": COCO_LABELS, "autoware": AUTOWARE_LABELS}[numbering]

    def id_of(self, label: str) -> int | None:
        """Row of the class that a label or a number means, ignoring case; None if it is not configured."""
        name = label.strip().lower()
        if name not in self._ids and name.isascii() and name.isdecimal() and len(name) < 10:
            number = int(name)
            name = self._numbered[number] if number < len(self._numbered) else name
        return self._ids.get(name)


def check_boxes(boxes: Sequence[Any], topic: str, limits: RecordingLimits) -> int:
    """The number of boxes of a message; raises MessageError if there are more than `limits` allow."""
    if len(boxes) > limits.max_boxes:
        raise MessageError(f"{topic}: {len(boxes)} boxes, expected at most {limits.max_boxes}: raise limit_scale")
    return len(boxes)


def found_objects(
    stamp_ns: int,
    frame_id: str,
    numbers: F64,
    covariances: F64,
    scores: F64,
    labels: Sequence[str | None],
    classes: ObjectClasses,
) -> FoundObjects:
    """The objects of a message that can be used; of the others, how many cannot, and why.

    `numbers` (N, 10) are position x, y, z, orientation x, y, z, w of any length, and size x, y, z; `covariances` (N,
    36) those of geometry_msgs/PoseWithCovariance. Scores (N,) are clipped to [0, 1]; a label is None where there is no
    class.
    """
    sizes, largest = numbers[:, 7:], np.abs(numbers[:, 3:7]).max(1, initial=0.0)
    is_solid = np.all(np.hstack([np.abs(numbers[:, :3]) <= MAX_M, sizes > 0, sizes <= MAX_M]), axis=1)
    is_turned = (largest > 1e-6) & (largest < 1e6)  # can be brought to unit length
    kept: list[int] = []
    class_ids: list[int] = []
    unused = Counter[str]()
    for row, label in enumerate(labels):
        class_id = None if label is None else classes.id_of(label)
        if label is None or not np.isfinite(scores[row]):
            unused["no class with a score"] += 1
        elif class_id is None:
            unused[f"class {one_line(label, max_characters=40)!r} is not configured"] += 1
        elif not is_solid[row]:
            unused["box without a volume, or out of all bounds"] += 1
        elif not is_turned[row]:
            unused["box without an orientation"] += 1
        else:
            kept.append(row)
            class_ids.append(class_id)
    at = np.array(kept, np.intp)
    quaternions = numbers[at, 3:7]
    rotations = matrix_of_quaternion(quaternions)
    return FoundObjects(
        stamp_ns,
        clean_frame(frame_id),
        PosedBoxes(numbers[at, :3], rotations, numbers[at, 7:], covariances[at].reshape(-1, 6, 6)),
        np.clip(scores[at], 0, 1).astype(np.float32),
        np.array(class_ids, np.int32),
        dict(sorted(unused.items())),
    )


DETECTED_OBJECTS = frozenset(
    {"autoware_perception_msgs/msg/DetectedObjects", "autoware_auto_perception_msgs/msg/DetectedObjects"}
)

UNAVAILABLE = 0
"""`orientation_availability` of an object whose heading is unknown."""

POLYGON = 2
"""`type` of a shape that is a footprint with a height."""

ANY_HEADING_RAD2 = np.pi**2 / 3
"""Variance of a heading of which nothing is known."""

_YAW = 35
"""Place of the variance of the rotation about z among the 36 of a pose."""


@decoder
def decode_detected_objects(
    message: RawMessage, classes: ObjectClasses, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> FoundObjects:
    """The objects of a message; raises MessageError if not a DetectedObjects, or more objects than `limits` allow."""
    array = deserialize_as(message, *sorted(DETECTED_OBJECTS), limits=limits)
    count = check_boxes(array.objects, message.topic, limits)
    numbers, covariances, scores = np.zeros((count, 10)), np.zeros((count, 36)), np.zeros(count)
    for row, one in enumerate(array.objects):
        numbers[row] = _numbers(one)
        covariances[row] = _covariance(one.kinematics)
        scores[row] = one.existence_probability
    labels = [_label(one) for one in array.objects]
    return found_objects(message.stamp_ns, array.header.frame_id, numbers, covariances, scores, labels, classes)


def _label(one: Any) -> str | None:
    """The likeliest class, of equal ones the first; None without one."""
    best = max(one.classification, key=lambda known: float(known.probability), default=None)
    if best is None:
        return None
    return AUTOWARE_LABELS[best.label] if best.label < len(AUTOWARE_LABELS) else str(best.label)


def _numbers(one: Any) -> F64:
    """(10,) position, orientation and size of the box around an object."""
    size = one.shape.dimensions
    at, turn = map(np.array, pose_numbers(one.kinematics.pose_with_covariance.pose))
    if one.kinematics.orientation_availability == UNAVAILABLE and not turn.any():
        turn = np.array([0.0, 0.0, 0.0, 1.0])
    extent = np.array([size.x, size.y, size.z])
    corners = np.array([[corner.x, corner.y] for corner in one.shape.footprint.points], np.float64).reshape(-1, 2)
    is_whole = len(corners) and np.isfinite(corners).all() and np.isfinite(turn).all() and turn.any()
    if one.shape.type == POLYGON and is_whole:
        low, high = corners.min(0), corners.max(0)
        extent[:2] = high - low
        at = at + matrix_of_quaternion(turn) @ [*((low + high) / 2), 0.0]
    return np.concatenate([at, turn, extent])


def _covariance(kinematics: Any) -> F64:
    """(36,) of the pose; without that of the position where it is not given, and with an open heading where it is."""
    found = np.array(kinematics.pose_with_covariance.covariance, np.float64)
    if not kinematics.has_position_covariance:
        found[:] = 0.0
    if kinematics.orientation_availability == UNAVAILABLE:
        found.reshape(6, 6)[5, :] = found.reshape(6, 6)[:, 5] = 0.0
        found[_YAW] = ANY_HEADING_RAD2
    return found


TRACKS = "lidcam_msgs/msg/TrackArray"

PREDICTED = "predicted"
"""The source of a track of which nothing was seen in the frame."""

MAX_NUMBER = 1e15
"""Numbers beyond this overflow when they are squared; the bound of boxes, too."""

_X_Y_YAW_RATE = np.array([0, 1, 5])
"""Rows of the 6 x 6 covariance of a twist."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundTracks(CheckedTable):
    """The tracks of one message, in recorded order."""

    stamp_ns: int  # Stamp of the message
    frame_id: str  # Frame along whose axes velocities are given
    tracks: Tracks  # N tracks, each number once
    is_predicted: Bools  # (N,) bool, whether nothing of the object was seen in the frame
    unused: Mapping[str, int]  # Number of other tracks by reason, sorted by reason


@decoder
def decode_tracks(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> FoundTracks:
    """The tracks of a message; of several with one number, the first."""
    array = deserialize_as(message, TRACKS, limits=limits)
    n = check_boxes(array.tracks, message.topic, limits)
    ids = np.array([one.id for one in array.tracks], np.int64)
    motions = [one.twist.twist for one in array.tracks]
    numbers = np.array(
        [
            (motion.linear.x, motion.linear.y, motion.angular.z, one.existence, one.age.sec + one.age.nanosec / 1e9)
            for one, motion in zip(array.tracks, motions, strict=True)
        ],
        np.float64,
    ).reshape(n, 5)
    covariances = np.array([one.twist.covariance for one in array.tracks], np.float64).reshape(n, 6, 6)
    covariances = covariances[:, _X_Y_YAW_RATE[:, None], _X_Y_YAW_RATE]
    is_numbered = ids > NO_TRACK
    is_first = np.zeros(n, np.bool_)
    is_first[np.unique(ids, return_index=True)[1]] = True
    is_sound = (np.abs(numbers) <= MAX_NUMBER).all(1) & (np.abs(covariances) <= MAX_NUMBER).all((1, 2))
    unused = Counter[str]()
    unused["track without a number"] = int((~is_numbered).sum())
    unused["track whose number another one has"] = int((is_numbered & ~is_first).sum())
    unused["track whose motion is not finite"] = int((is_numbered & is_first & ~is_sound).sum())
    kept = np.flatnonzero(is_numbered & is_first & is_sound)
    return FoundTracks(
        message.stamp_ns,
        clean_frame(array.header.frame_id),
        Tracks(
            ids[kept],
            numbers[kept, :2],
            covariances[kept, :2, :2],
            numbers[kept, 2],
            covariances[kept, 2, 2],
            np.clip(numbers[kept, 3], 0, 1),
            numbers[kept, 4],
            np.array([bool(array.tracks[row].front_known) for row in kept.tolist()], np.bool_),
        ),
        np.array([array.tracks[row].source == PREDICTED for row in kept.tolist()], np.bool_),
        {reason: count for reason, count in sorted(unused.items()) if count},
    )
