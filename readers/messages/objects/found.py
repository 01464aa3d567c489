"""The common part of all messages of 3D objects: rows of numbers, labels and scores become boxes."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, Bools
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.posed_boxes import PosedBoxes
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.pipeline.detectors.onnx.class_names import COCO_LABELS
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
    """The configured classes by what detectors call them."""

    def __init__(self, config: Config) -> None:
        numbering = config.detect3d.recorded.class_numbers
        known = config.class_id_of_label
        self._ids = (
            known if numbering == "labels" else {name: row for name, row in known.items() if not name.isdecimal()}
        )
        self._numbered = {"labels": (), "coco": COCO_LABELS, "autoware": AUTOWARE_LABELS}[numbering]

    def id_of(self, label: str) -> int | None:
        """Row of the class that a label or a number means, ignoring case; None if it is not configured."""
        name = label.strip().lower()
        if name not in self._ids and name.isascii() and name.isdecimal() and len(name) < 10:
            number = int(name)
            name = self._numbered[number] if number < len(self._numbered) else name
        return self._ids.get(name)


def check_boxes(boxes: Sequence[Any], topic: str, limits: RecordingLimits) -> int:
    """The number of boxes of a message.

    Raises:
        MessageError: there are more than `limits` allow.
    """
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
    """The objects that can be used; of the others, how many cannot, and why.

    Args:
        stamp_ns: Stamp of the message.
        frame_id: As recorded.
        numbers: (N, 10) position x, y, z; orientation x, y, z, w, of any length; size x, y, z.
        covariances: (N, 36) of the pose, as in geometry_msgs/PoseWithCovariance.
        scores: (N,) clipped to [0, 1].
        labels: (N,) class of each; None where it has none.
        classes: The configured classes.
    """
    is_solid, is_turned = _is_solid(numbers), _is_turned(numbers[:, 3:7])
    kept: list[int] = []
    class_ids: list[int] = []
    unused = Counter[str]()
    for row, label in enumerate(labels):
        class_id = None if label is None else classes.id_of(label)
        if label is None or not np.isfinite(scores[row]):
            unused["no class with a score"] += 1
        elif class_id is None:
            unused[f"class {label.strip()!r} is not configured"] += 1
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


def _is_solid(numbers: F64) -> Bools:
    """(N,) whether centre and size are finite and the size has a volume."""
    sizes = numbers[:, 7:]
    is_placed = (np.isfinite(numbers[:, :3]) & (np.abs(numbers[:, :3]) <= MAX_M)).all(1)
    return np.asarray(is_placed & (np.isfinite(sizes) & (sizes > 0) & (sizes <= MAX_M)).all(1))


def _is_turned(quaternions: F64) -> Bools:
    """(N,) whether quaternions are finite and can be brought to unit length."""
    largest = np.abs(quaternions).max(1, initial=0.0)
    return np.asarray(np.isfinite(quaternions).all(1) & (largest > 1e-6) & (largest < 1e6))
