"""Tracks of the objects of one frame: identity, motion and existence."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, CheckedTable
from lidcam.pipeline.core.text import brief

NO_TRACK = 0
"""Track number of an object that belongs to no track; `Tracks.none` makes zeros."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(CheckedTable):
    """The tracks of N objects of one frame, in the objects' order."""

    ROWS: ClassVar = {"velocities": (2,), "velocity_covariances": (2, 2)}

    ids: I64  # (N,) int64, number of the track from 1, the same in all frames; `NO_TRACK` for an object without one
    velocities: F64  # (N, 2) float64, over the ground, along x and y of the site frame as it stands in this frame, m/s
    velocity_covariances: F64  # (N, 2, 2) float64 over them, (m/s)^2
    yaw_rates: F64  # (N,) float64, over the ground, rad/s, counter-clockwise
    yaw_rate_variances: F64  # (N,) float64, (rad/s)^2
    existence: F64  # (N,) float64 in [0, 1], probability that the track is an object of its class
    ages_s: F64  # (N,) float64, since the track was first seen
    fronts_known: Bools  # (N,) bool, whether its motion has shown which end of the object is its front

    __repr__ = brief

    @property
    def speeds(self) -> F64:
        """(N,) over the ground, m/s."""
        return np.hypot(self.velocities[:, 0], self.velocities[:, 1])

    @classmethod
    def none(cls, count: int) -> Self:
        """Objects that belong to no track: nothing is known of their motion."""
        return cls.zeros(count)
