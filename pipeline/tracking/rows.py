"""What trackers give for a frame: one row per track, in the fixed frame."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Table

NOT_SEEN = -1
"""In place of a sighting, where the frame shows nothing of a track."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackRows(Table):
    """N tracks in one frame, by rising number.

    Attributes:
        ids: (N,) int64.
        states: (N, 5) float64, as in `lidcam.pipeline.tracking.motion`, at the frame's stamp; places are those of the
            centres.
        covariances: (N, 5, 5) float64.
        heights_m: (N,) float64, z of the centre.
        sizes: (N, 3) float64.
        class_ids: (N,) int64.
        existence: (N,) float64.
        ages_s: (N,) float64.
        fronts_known: (N,) bool.
        seen: (N,) int64, row of the frame's `Sightings`, or `NOT_SEEN`.
    """

    ids: I64
    states: F64
    covariances: F64
    heights_m: F64
    sizes: F64
    class_ids: I64
    existence: F64
    ages_s: F64
    fronts_known: Bools
    seen: I64

    @classmethod
    def none(cls) -> Self:
        """No track."""
        zeros, numbers = np.zeros(0), np.zeros(0, np.int64)
        states, covariances = np.zeros((0, 5)), np.zeros((0, 5, 5))
        no = np.zeros(0, np.bool_)
        return cls(numbers, states, covariances, zeros, np.zeros((0, 3)), numbers, zeros, zeros, no, numbers)

    @property
    def are_seen(self) -> Bools:
        """(N,) whether the frame shows something of each."""
        return np.asarray(self.seen != NOT_SEEN)
