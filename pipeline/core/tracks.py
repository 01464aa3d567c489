"""Tracks of the objects of one frame: identity, motion and existence."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, CheckedTable
from lidcam.pipeline.core.text import brief

NO_TRACK = 0
"""Track number of an object that belongs to no track; `Tracks.none` makes zeros."""

UNKNOWN_VARIANCE = 1e6
"""Variances, (m/s)^2 and (rad/s)^2, of a motion that is not known: its numbers are zero and say nothing."""

MIN_MOVING_SPEED_M_S = 0.3
"""Minimum speed that counts as moving."""

MOVING_SIGMAS = 3.0
"""Minimum speed that counts as moving, in its standard deviations.

Measured: in online tracks parked cars reach 2.9, two of 70 reach 3.3; people who walk for a second or more reach 3.5.
"""


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
    def motions(self) -> F64:
        """(N, 3) velocities and yaw rates; NaN where they are not known."""
        motions = np.column_stack([self.velocities, self.yaw_rates])
        motions[self.velocity_covariances[:, 0, 0] >= UNKNOWN_VARIANCE] = np.nan
        return motions

    @property
    def speeds(self) -> F64:
        """(N,) over the ground, m/s; NaN where they are not known."""
        velocities = self.motions[:, :2]
        return np.hypot(velocities[:, 0], velocities[:, 1])

    @property
    def moving(self) -> Bools:
        """(N,) whether each moves: its speed is high enough, and beyond its own uncertainty."""
        speeds = self.speeds
        along = np.einsum("ni,nij,nj->n", self.velocities, self.velocity_covariances, self.velocities)
        return np.asarray((speeds >= MIN_MOVING_SPEED_M_S) & (speeds**2 >= MOVING_SIGMAS * np.sqrt(along)))

    def without_motion(self, rows: Bools) -> Self:
        """The same tracks, the motion of those where the mask is true not known."""
        return replace(
            self,
            velocities=np.where(rows[:, None], 0.0, self.velocities),
            velocity_covariances=np.where(rows[:, None, None], UNKNOWN_VARIANCE * np.eye(2), self.velocity_covariances),
            yaw_rates=np.where(rows, 0.0, self.yaw_rates),
            yaw_rate_variances=np.where(rows, UNKNOWN_VARIANCE, self.yaw_rate_variances),
        )

    @classmethod
    def none(cls, count: int) -> Self:
        """Objects that belong to no track: nothing is known of their motion."""
        return cls.zeros(count)
