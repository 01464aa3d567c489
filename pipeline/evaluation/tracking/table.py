"""Truth and results of one class in all frames, and which of them are near each other."""

from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Rows, Table
from lidcam.pipeline.evaluation.near_objects import Candidates


@dataclass(frozen=True, slots=True, eq=False)
class TrackRows(Table):
    """True objects or boxes found, by frame, then class, then track. A track is in a frame and class at most once."""

    frames: I32  # (N,) int32, number of the evaluated frame
    class_ids: I32  # (N,) int32
    tracks: I64  # (N,) int64
    yaws: F64  # (N,) float64
    scores: F64  # (N,) float64; 0 for a true object

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
