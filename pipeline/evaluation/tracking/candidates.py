"""The objects of some frames side by side, and which of them are near each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Indices, check_array
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.rotated_iou import BoxArrays, pair_ious
from pipeline.evaluation.assignment import pairs_of_equal
from pipeline.evaluation.evaluation_frame import TruthBoxes3D

__all__ = ["Candidates", "Objects", "near_pairs", "near_rows"]


@dataclass(frozen=True, slots=True, eq=False)
class Objects:
    """True objects, or boxes found, of some frames.

    Attributes:
        frames: (N,) int64.
        class_ids: (N,) int64, or `UNKNOWN`.
        tracks: (N,) int64, or `UNKNOWN`.
        boxes: Places and sizes.
    """

    frames: I64
    class_ids: I64
    tracks: I64
    boxes: BoxArrays

    def __post_init__(self) -> None:
        for name in ("frames", "class_ids", "tracks"):
            check_array(name, getattr(self, name), (len(self.frames),), np.int64)

    @classmethod
    def of(cls, parts: Sequence[TruthBoxes3D] | Sequence[Boxes3D], frames: Sequence[int], tracks: I64) -> Self:
        """The objects of at least one frame; `frames` has the number of each."""
        boxes = BoxArrays(
            np.concatenate([part.centers for part in parts]),
            np.concatenate([part.sizes for part in parts]),
            np.concatenate([part.yaws for part in parts]),
        )
        class_ids = np.concatenate([part.class_ids for part in parts]).astype(np.int64)
        return cls(np.repeat(np.array(frames, np.int64), [len(part.yaws) for part in parts]), class_ids, tracks, boxes)

    def __len__(self) -> int:
        return len(self.frames)

    def select(self, rows: Indices | Bools) -> "Objects":
        """The given rows (mask or indices), in that order."""
        boxes = BoxArrays(*(column[rows] for column in self.boxes))
        return Objects(self.frames[rows], self.class_ids[rows], self.tracks[rows], boxes)

    @property
    def ranges_m(self) -> F64:
        """(N,) from the origin, along the ground."""
        return np.asarray(np.hypot(self.boxes.centers[:, 0], self.boxes.centers[:, 1]))

    @property
    def is_repeated(self) -> Bools:
        """(N,) whether a row has the frame, class and track of the row before it."""
        same = np.zeros(len(self), np.bool_)
        same[1:] = (np.diff(self.frames) == 0) & (np.diff(self.class_ids) == 0) & (np.diff(self.tracks) == 0)
        return same


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairs of a true object and a box found, ordered by the former's row, then by the latter's.

    Attributes:
        first: (P,) int64, row of the truth.
        second: (P,) int64, row of the box found.
        distances_m: (P,) float64, between the centres, along the ground.
        ious: (P,) float64, seen from above.
    """

    first: I64
    second: I64
    distances_m: F64
    ious: F64

    def of_found(self, kept: Bools) -> "Candidates":
        """The pairs whose boxes found (M,) are kept; these are numbered anew."""
        rows = kept[self.second]
        second = (np.cumsum(kept) - 1)[self.second[rows]]
        return Candidates(self.first[rows], second, self.distances_m[rows], self.ious[rows])


def near_pairs(truth: Objects, found: Objects, max_distances_m: F64) -> Candidates:
    """Pairs of one frame and class that are near each other, or may overlap.

    Args:
        truth: Objects of known classes, by frame and class.
        found: Boxes found, by frame and class.
        max_distances_m: (C,) of each class.
    """
    count = len(max_distances_m)
    first, second = pairs_of_equal(truth.frames * count + truth.class_ids, found.frames * count + found.class_ids)
    distances_m = _distances_m(truth, first, found, second)
    reach_m = _radii_m(truth)[first] + _radii_m(found)[second]
    near = distances_m < np.maximum(max_distances_m[truth.class_ids[first]], reach_m)
    first, second = first[near], second[near]
    return Candidates(
        first, second, distances_m[near], pair_ious(truth.select(first).boxes, found.select(second).boxes).bev
    )


def near_rows(objects: Objects, found: Objects, max_distances_m: F64) -> Bools:
    """(M,) which boxes found are near one of the objects of their frame, of whatever class.

    Args:
        objects: By frame.
        found: By frame.
        max_distances_m: (C,) of each class; that of the box found counts.
    """
    first, second = pairs_of_equal(objects.frames, found.frames)
    is_near = np.zeros(len(found), np.bool_)
    distances_m = _distances_m(objects, first, found, second)
    is_near[second[distances_m < max_distances_m[found.class_ids[second]]]] = True
    return is_near


def _distances_m(first: Objects, first_rows: I64, second: Objects, second_rows: I64) -> F64:
    gap_m = first.boxes.centers[first_rows, :2] - second.boxes.centers[second_rows, :2]
    return np.asarray(np.hypot(gap_m[:, 0], gap_m[:, 1]))


def _radii_m(objects: Objects) -> F64:
    return np.asarray(np.hypot(objects.boxes.sizes[:, 0], objects.boxes.sizes[:, 1]) / 2)
