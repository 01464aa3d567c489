"""Whether the lower part of a cluster is hidden by something nearer to the lidar, or is not there."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.native.kernels import hidden_below

SECTOR_RAD = np.deg2rad(1.0)
"""Width of a sector, within which points stand in one line of sight, roughly."""

SECTORS = int(2 * np.pi / SECTOR_RAD) + 2
"""Sectors of a lidar, with room for rounding."""

MAX_NEARER_SHARE = 0.97
"""Maximum distance of a point that hides another, as a share of the other's distance."""

MIN_HIDDEN_SHARE = 0.5
"""Minimum share of a cluster's sectors in which it is hidden below, for it to count as hidden."""


class Sight(NamedTuple):
    """All points of a frame, by lidar and azimuth."""

    origins: F64  # (L, 3) x, y of the lidars in the site frame and their heights above the ground, metres
    starts: I64  # (S + 1,) first point of each sector, lidar after lidar
    distance_m: F64  # (N,) horizontal distance of each point from its lidar, sector after sector
    slope: F64  # (N,) rise of the line of sight to each for a metre of that distance

    @classmethod
    def of(cls, position: F64, lidar: I64, origins: F64) -> "Sight":
        """From points (N, 3) x, y and height above the ground, and the lidar (N,) of each."""
        sector, distance_m, slope = _seen(position, lidar, origins)
        # Numpy sorts numbers of 16 bits in one pass.
        order = np.argsort(sector.astype(np.min_scalar_type(len(origins) * SECTORS)), kind="stable")
        starts = np.searchsorted(sector[order], np.arange(len(origins) * SECTORS + 1))
        return cls(origins, starts, distance_m[order], slope[order])

    def is_hidden_below(self, position: F64, lidar: I64, starts: I64, from_m: float) -> Bools:
        """(C,) whether something nearer hides what each cluster may have between the ground and its bottom.

        A nearer point hides it if the line of sight through it meets the cluster below its bottom, but no lower than
        half of `from_m`: so the view is shut up to where the cluster begins.

        Args:
            position: (P, 3) x, y and height above the ground, sorted by cluster.
            lidar: (P,) lidar of each point.
            starts: (C,) first point of each cluster; each has one.
            from_m: Height below which a cluster has to begin if it stands on the ground.
        """
        sector, distance_m, _ = _seen(position, lidar, self.origins)
        return hidden_below(
            self.starts,
            self.distance_m,
            self.slope,
            np.ascontiguousarray(position[:, 2]),
            sector,
            distance_m,
            self.origins[:, 2].take(lidar),
            starts,
            from_m / 2,
            MAX_NEARER_SHARE,
            MIN_HIDDEN_SHARE,
        )


def _seen(position: F64, lidar: I64, origins: F64) -> tuple[I64, F64, F64]:
    """Sector, horizontal distance and slope of the line of sight of points (N, 3)."""
    x, y, z = (position[:, axis] - origins[:, axis].take(lidar) for axis in range(3))
    distance_m = np.maximum(np.hypot(x, y), 1e-9)
    sector = ((np.arctan2(y, x) + np.pi) / SECTOR_RAD).astype(np.int64)
    return lidar * SECTORS + sector, distance_m, z / distance_m
