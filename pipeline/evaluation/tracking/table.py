"""Truth and results of one class in all frames, and which of them are near each other."""

from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Rows, Table
from lidcam.pipeline.core.geometry.rotated_iou import OrientedBoxes
from lidcam.pipeline.evaluation.near_objects import Candidates


@dataclass(frozen=True, slots=True, eq=False)
class TrackRows(Table):
    """True objects or boxes found, by frame, then class, then track. A track is in a frame and class at most once."""

    frames: I32  # (N,) int32, number of the evaluated frame
    class_ids: I32  # (N,) int32
    tracks: I64  # (N,) int64
    yaws: F64  # (N,) float64
    ranges_m: F64  # (N,) float64, from the origin, along the ground
    scores: F64  # (N,) float64; 0 for a true object
    poses: F64  # (N, 3) float64, x, y (metres) and yaw over the ground; NaN where that is not known

    @classmethod
    def of(cls, frames: I32, boxes: OrientedBoxes, class_ids: I32, tracks: I64, scores: F64, poses: F64) -> "TrackRows":
        """The rows of boxes (N,)."""
        ranges_m = np.hypot(boxes.centers[:, 0], boxes.centers[:, 1])
        return cls(frames, class_ids, tracks, boxes.yaws, ranges_m, scores, poses)

    @property
    def track_count(self) -> int:
        """Number of tracks, where these are numbered from 0."""
        return int(self.tracks.max(initial=-1)) + 1

    def numbered(self, rows: Rows) -> "TrackRows":
        """Some of the rows (mask or indices), with tracks numbered from 0 in the order of their ids."""
        kept = self.select(rows)
        return replace(kept, tracks=np.unique(kept.tracks, return_inverse=True)[1].astype(np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class TrackTable:
    """The objects of one class that have to be found, and the boxes that a source found, with their tracks.

    No result depends on the order of the objects in a message. Tracks are numbered from 0.
    """

    stamps_ns: I64  # (F,) int64, time of each frame
    truth: TrackRows  # N true objects
    found: TrackRows  # M boxes found
    pairs: Candidates  # Pairs of `truth` and `found` that are near enough to be one object, or overlap
    max_distance_m: float  # From this distance on a pair is no match
    length_m: float  # Length of the class
    # Boxes found that have no track, or share it with another box of their frame; not in the table
    without_track: int = 0

    def part(self, truth: Bools, found: Bools) -> "TrackTable":
        """The true objects (N,) and boxes (M,) that are kept."""
        pairs = self.pairs.among(truth, found)
        return replace(self, truth=self.truth.numbered(truth), found=self.found.numbered(found), pairs=pairs)
