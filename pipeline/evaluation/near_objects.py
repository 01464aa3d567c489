"""The boxes of some frames side by side, and which of them are near each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Indices, Table, join_rows, pairs_of_equal
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays, OrientedBoxes, pair_ious
from lidcam.pipeline.evaluation.evaluation_frame import Motion, SourceBoxes, TruthBoxes3D

NEAR_M = 4.0
"""Largest distance of the centres at which two boxes are compared, for objects as long as a car."""

Measure = Literal["bev", "volume", "distance"]


@dataclass(frozen=True, slots=True, eq=False)
class TrueObjects(Table):
    """True objects of some frames, frame by frame."""

    frames: I32  # (T,) int32, number of the evaluated frame, rising
    boxes: TruthBoxes3D  # The objects; their stamp and frame of reference are those of the first frame

    @classmethod
    def of(cls, truths: Sequence[TruthBoxes3D], first_frame: int) -> "TrueObjects":
        """The objects of at least one frame; the frames are numbered from `first_frame`."""
        return cls(_frames(list(map(len, truths)), first_frame), join_rows(*truths))


@dataclass(frozen=True, slots=True, eq=False)
class FoundObjects(Table):
    """Detections of one source in some frames, frame by frame."""

    frames: I32  # (N,) int32, number of the evaluated frame, rising
    boxes: Boxes3D  # The detections; their stamp and frame of reference mean nothing
    track_ids: I64  # (N,) int64, or `UNKNOWN`
    motion: Motion  # Motion of their tracks
    is_ignored: Bools  # (N,) as of `SourceBoxes`

    @classmethod
    def of(cls, sources: Sequence[SourceBoxes | None], first_frame: int) -> "FoundObjects":
        """The detections of frames that are numbered from `first_frame`; None for a frame without the source."""
        given = [source for source in sources if source is not None]
        return cls(
            _frames([0 if source is None else len(source) for source in sources], first_frame),
            join_rows(Boxes3D.empty(0, ""), *(source.boxes for source in given)),
            np.concatenate([np.zeros(0, np.int64), *(source.track_ids for source in given)]),
            join_rows(Motion.unknown(0), *(source.motion or Motion.unknown(len(source)) for source in given)),
            np.concatenate([np.zeros(0, np.bool_), *map(_are_ignored, given)]),
        )


def _are_ignored(source: SourceBoxes) -> Bools:
    return np.zeros(len(source), np.bool_) if source.is_ignored is None else source.is_ignored


@dataclass(frozen=True, slots=True, eq=False)
class Candidates(Table):
    """Pairs of a true object and a detection of the same frame that may belong together."""

    truth: Indices  # (P,) rows of the true objects
    found: Indices  # (P,) rows of the detections
    bev: F64  # (P,) float64, IoU seen from above
    volume: F64  # (P,) float64, IoU in 3D
    distances_m: F64  # (P,) float64, of the centres seen from above

    def best_first(self, measure: Measure) -> Indices:
        """The pairs detection by detection, the best true object first, the earlier one of two equally good ones."""
        values = {"distance": self.distances_m, "bev": -self.bev, "volume": -self.volume}[measure]
        return np.lexsort((self.truth, values, self.found))

    def among(self, truth: Bools, found: Bools) -> "Candidates":
        """The pairs of true objects (T,) and detections (N,) that are kept, with rows counted among these alone."""
        kept = self.select(truth[self.truth] & found[self.found])
        rows = (np.cumsum(truth) - 1)[kept.truth], (np.cumsum(found) - 1)[kept.found]
        return Candidates(*rows, kept.bev, kept.volume, kept.distances_m)


def pairs_near(found: FoundObjects, truth: TrueObjects, scales: F64) -> Candidates:
    """Pairs of the same frame that overlap or are nearer to each other than `NEAR_M`, by true object, then detection.

    `scales` (C,) are factors of the distance by class; the larger one of the two objects counts.
    """
    columns, rows = pairs_of_equal(truth.frames, found.frames)
    gap_m = found.boxes.centers[rows, :2] - truth.boxes.centers[columns, :2]
    distances_m = np.hypot(gap_m[:, 0], gap_m[:, 1])
    reach_m = np.append(scales * NEAR_M, 0.0)  # an object of no class takes the distance of the detection's
    limits_m = np.maximum(reach_m[found.boxes.class_ids][rows], reach_m[truth.boxes.class_ids][columns])
    touching = distances_m < _half_diagonals(found.boxes)[rows] + _half_diagonals(truth.boxes)[columns]
    near = np.flatnonzero(touching | (distances_m < limits_m))
    rows, columns, touching = rows[near], columns[near], touching[near]
    bev, volume = np.zeros(len(rows)), np.zeros(len(rows))
    both = BoxArrays.of(found.boxes, rows[touching]), BoxArrays.of(truth.boxes, columns[touching])
    bev[touching], volume[touching] = pair_ious(*both)
    return Candidates(columns, rows, bev, volume, distances_m[near])


def _frames(counts: Sequence[int], first_frame: int) -> I32:
    return np.repeat(np.arange(first_frame, first_frame + len(counts), dtype=np.int32), counts)


def _half_diagonals(boxes: OrientedBoxes) -> F64:
    return np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2
