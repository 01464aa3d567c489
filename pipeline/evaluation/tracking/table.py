"""Truth and results of one class in all frames, and which of them are near each other."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import F64, I64, check_array

__all__ = ["TrackTable"]


@dataclass(frozen=True, slots=True, eq=False)
class TrackTable:
    """The objects of one class that have to be found, and the boxes that a source found, with their tracks.

    Rows are ordered by frame, then by track, so that no result depends on the order of the objects in a message. Tracks
    are numbered from 0. A track is in a frame at most once.

    Attributes:
        stamps_ns: (F,) int64, time of each frame.
        truth_frames: (N,) int64, frame of each true object.
        truth_tracks: (N,) int64, its track.
        truth_yaws: (N,) float64.
        truth_ranges_m: (N,) float64, from the origin, along the ground.
        found_frames: (M,) int64, frame of each box found.
        found_tracks: (M,) int64, its track.
        found_yaws: (M,) float64.
        found_ranges_m: (M,) float64, from the origin, along the ground.
        found_scores: (M,) float64.
        first: (P,) int64, row of the truth of each candidate: a pair of one frame near enough to be one object, or
            with an overlap. Ordered by `first`, then `second`.
        second: (P,) int64, row of the box found.
        distances_m: (P,) float64, between the centres, along the ground.
        ious: (P,) float64, of the boxes seen from above.
        max_distance_m: From this distance on a pair is no match.
        without_track: Boxes found that have no track, or share it with another box of their frame; not in the table.
    """

    stamps_ns: I64
    truth_frames: I64
    truth_tracks: I64
    truth_yaws: F64
    truth_ranges_m: F64
    found_frames: I64
    found_tracks: I64
    found_yaws: F64
    found_ranges_m: F64
    found_scores: F64
    first: I64
    second: I64
    distances_m: F64
    ious: F64
    max_distance_m: float
    without_track: int = 0

    def __post_init__(self) -> None:
        frames, n, m, p = (len(a) for a in (self.stamps_ns, self.truth_frames, self.found_frames, self.first))
        check_array("stamps_ns", self.stamps_ns, (frames,), "int64")
        for name in ("truth_frames", "truth_tracks"):
            check_array(name, getattr(self, name), (n,), "int64")
        for name in ("found_frames", "found_tracks"):
            check_array(name, getattr(self, name), (m,), "int64")
        for name in ("first", "second"):
            check_array(name, getattr(self, name), (p,), "int64")
        for name in ("truth_yaws", "truth_ranges_m"):
            check_array(name, getattr(self, name), (n,), "float64")
        for name in ("found_yaws", "found_ranges_m", "found_scores"):
            check_array(name, getattr(self, name), (m,), "float64")
        for name in ("distances_m", "ious"):
            check_array(name, getattr(self, name), (p,), "float64")

    def within(self, max_range_m: float) -> "TrackTable":
        """What lies nearer to the origin than that; the rest is gone, as where it was never looked for."""
        truth, found = self.truth_ranges_m < max_range_m, self.found_ranges_m < max_range_m
        pairs = truth[self.first] & found[self.second]
        return replace(
            self,
            truth_frames=self.truth_frames[truth],
            truth_tracks=np.unique(self.truth_tracks[truth], return_inverse=True)[1].astype(np.int64),
            truth_yaws=self.truth_yaws[truth],
            truth_ranges_m=self.truth_ranges_m[truth],
            found_frames=self.found_frames[found],
            found_tracks=np.unique(self.found_tracks[found], return_inverse=True)[1].astype(np.int64),
            found_yaws=self.found_yaws[found],
            found_ranges_m=self.found_ranges_m[found],
            found_scores=self.found_scores[found],
            first=(np.cumsum(truth) - 1)[self.first[pairs]],
            second=(np.cumsum(found) - 1)[self.second[pairs]],
            distances_m=self.distances_m[pairs],
            ious=self.ious[pairs],
        )

    @property
    def truth_track_count(self) -> int:
        """Number of true tracks."""
        return int(self.truth_tracks.max(initial=-1)) + 1

    @property
    def found_track_count(self) -> int:
        """Number of tracks found."""
        return int(self.found_tracks.max(initial=-1)) + 1
