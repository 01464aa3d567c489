"""The boxes of some frames side by side, and which of them are near each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I32, Bools, Indices
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.geometry.rotated_iou import BoxArrays, OrientedBoxes, pair_ious
from pipeline.evaluation.assignment import pairs_of_equal
from pipeline.evaluation.detection.criteria import DISTANCES_M
from pipeline.evaluation.detection.matching import Candidates
from pipeline.evaluation.evaluation_frame import Names, SourceBoxes, TruthBoxes3D

__all__ = [
    "FoundObjects",
    "TrueObjects",
    "check_class_ids",
    "check_numbers",
    "errors_of_pairs",
    "pairs_near",
]


@dataclass(frozen=True, slots=True, eq=False)
class TrueObjects:
    """True objects of some frames, frame by frame.

    Attributes:
        frames: (T,) int32, number of the evaluated frame, ascending.
        centers: (T, 3) float64, metres.
        sizes: (T, 3) float64, metres.
        yaws: (T,) float64.
        class_ids: (T,) int32, or `UNKNOWN`.
        labels: (T,) str.
        lidar_points: (T,) int32, or `UNKNOWN`.
        image_pixels: (T,) int32, or `UNKNOWN`.
        is_ignored: (T,) bool, by the truth itself.
    """

    frames: I32
    centers: F64
    sizes: F64
    yaws: F64
    class_ids: I32
    labels: Names
    lidar_points: I32
    image_pixels: I32
    is_ignored: Bools

    @classmethod
    def of(cls, truths: Sequence[TruthBoxes3D], first_frame: int) -> "TrueObjects":
        """The objects of at least one frame; the frames are numbered from `first_frame`."""
        frames = np.repeat(np.arange(len(truths), dtype=np.int32), [len(truth) for truth in truths])
        return cls(
            (frames + first_frame).astype(np.int32),
            np.concatenate([truth.centers for truth in truths]),
            np.concatenate([truth.sizes for truth in truths]),
            np.concatenate([truth.yaws for truth in truths]),
            np.concatenate([truth.class_ids for truth in truths]),
            np.concatenate([truth.labels for truth in truths]),
            np.concatenate([truth.lidar_points for truth in truths]),
            np.concatenate([truth.image_pixels for truth in truths]),
            np.concatenate([truth.is_ignored for truth in truths]),
        )

    def __len__(self) -> int:
        return len(self.frames)


@dataclass(frozen=True, slots=True, eq=False)
class FoundObjects:
    """Detections of one source in some frames, frame by frame.

    Attributes:
        frames: (N,) int32, number of the evaluated frame, ascending.
        centers: (N, 3) float64, metres.
        sizes: (N, 3) float64, metres.
        yaws: (N,) float64.
        class_ids: (N,) int32.
        scores: (N,) float32.
    """

    frames: I32
    centers: F64
    sizes: F64
    yaws: F64
    class_ids: I32
    scores: F32

    @classmethod
    def of(cls, sources: Sequence[SourceBoxes | None], first_frame: int) -> "FoundObjects":
        """The detections of frames that are numbered from `first_frame`; None where the source says nothing."""
        boxes = [source.boxes for source in sources if source is not None]
        counts = [0 if source is None else len(source) for source in sources]
        frames = np.repeat(np.arange(len(sources), dtype=np.int32), counts)
        return cls(
            (frames + first_frame).astype(np.int32),
            np.concatenate([np.zeros((0, 3)), *(box.centers for box in boxes)]),
            np.concatenate([np.zeros((0, 3)), *(box.sizes for box in boxes)]),
            np.concatenate([np.zeros(0), *(box.yaws for box in boxes)]),
            np.concatenate([np.zeros(0, np.int32), *(box.class_ids for box in boxes)]),
            np.concatenate([np.zeros(0, np.float32), *(box.scores for box in boxes)]),
        )

    def __len__(self) -> int:
        return len(self.frames)


def pairs_near(found: FoundObjects, truth: TrueObjects, scales: F64) -> Candidates:
    """Pairs of the same frame that overlap or are no farther from each other than the largest distance of a criterion.

    Args:
        found: The detections.
        truth: The true objects of the same frames.
        scales: (C,) by class, factor of the distances.
    """
    rows, columns = pairs_of_equal(found.frames, truth.frames)
    gap_m = found.centers[rows, :2] - truth.centers[columns, :2]
    distances_m = np.hypot(gap_m[:, 0], gap_m[:, 1])
    # an object of no class takes the limits of the detection's
    reach_m = np.append(scales * DISTANCES_M[-1], 0.0)
    limits_m = np.maximum(reach_m[found.class_ids][rows], reach_m[truth.class_ids][columns])
    touching = distances_m < _half_diagonals(found)[rows] + _half_diagonals(truth)[columns]
    near = np.flatnonzero(touching | (distances_m < limits_m))
    rows, columns, touching = rows[near], columns[near], touching[near]
    bev, volume = np.zeros(len(rows)), np.zeros(len(rows))
    bev[touching], volume[touching] = pair_ious(_boxes(found, rows[touching]), _boxes(truth, columns[touching]))
    return Candidates(rows, columns, bev, volume, distances_m[near])


def errors_of_pairs(found: FoundObjects, truth: TrueObjects, rows: Indices, columns: Indices) -> F64:
    """Errors of detections that show true objects, detection minus truth.

    Args:
        found: The detections.
        truth: The true objects.
        rows: (P,) detections.
        columns: (P,) the object that each of them shows.

    Returns:
        (P, 8): along and across the object's heading, up, length, width, height (metres), yaw (radians, in (-pi, pi]),
        and 1 - IoU of the sizes alone, as if centre and yaw agreed.
    """
    gap_m = found.centers[rows] - truth.centers[columns]
    cos, sin = np.cos(truth.yaws[columns]), np.sin(truth.yaws[columns])
    along_m, across_m = gap_m[:, 0] * cos + gap_m[:, 1] * sin, gap_m[:, 1] * cos - gap_m[:, 0] * sin
    sizes, true_sizes = found.sizes[rows], truth.sizes[columns]
    shared_m3 = np.minimum(sizes, true_sizes).prod(1)
    joined_m3 = sizes.prod(1) + true_sizes.prod(1) - shared_m3
    scale = 1 - np.divide(shared_m3, joined_m3, out=np.zeros(len(rows)), where=joined_m3 > 0)
    turn = wrap_angle(found.yaws[rows] - truth.yaws[columns])
    return np.column_stack([along_m, across_m, gap_m[:, 2], sizes - true_sizes, turn, scale])


def check_numbers(name: str, *numbers: F64 | F32) -> None:
    """Check what a comparison would not notice.

    Raises:
        ValueError: a number is not finite.
    """
    if not all(np.isfinite(array).all() for array in numbers):
        raise ValueError(f"{name}: expected finite numbers in boxes and scores")


def check_class_ids(name: str, class_ids: I32, expected: range) -> None:
    """Check classes (N,).

    Raises:
        ValueError: one is not in the expected range.
    """
    if len(class_ids) and not (class_ids.min() in expected and class_ids.max() in expected):
        found = f"{class_ids.min()} to {class_ids.max()}"
        raise ValueError(f"{name}: class ids {found}, expected {expected.start} to {expected.stop - 1}")


def _half_diagonals(boxes: OrientedBoxes) -> F64:
    return np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2


def _boxes(boxes: OrientedBoxes, rows: Indices) -> BoxArrays:
    return BoxArrays(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows])
