"""Whether the lower part of a cluster is hidden by something nearer to the lidar, or is not there."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.detectors.cluster.grid_kernels import ascending

__all__ = ["Sight"]


SECTOR_RAD = np.deg2rad(1.0)
"""Points whose azimuths differ by less stand in one line of sight, roughly."""

NEARER_SHARE = 0.97
"""What hides is nearer than this share of the distance of what is hidden."""

HIDDEN_SHARE = 0.5
"""A cluster is hidden below if it is so in this share of its sectors."""


@dataclass(frozen=True, eq=False)
class Sight:
    """All points of a frame, by lidar and azimuth.

    Attributes:
        origins: (L, 3) x, y of the lidars in the site frame and their heights above the ground, metres.
        sector: (N,) sector of each point, ascending; those of a lidar follow those of the one before.
        distance_m: (N,) horizontal distance of each from its lidar.
        slope: (N,) rise of the line of sight to each for a metre of that distance.
    """

    origins: F64
    sector: I64
    distance_m: F64
    slope: F64

    @classmethod
    def of(cls, position: F64, lidar: I64, origins: F64) -> "Sight":
        """What the lidars see: points (N, 3) x, y and height above the ground, and the lidar (N,) of each."""
        sector, distance_m, slope = _seen(position, lidar, origins)
        order = ascending(sector)
        return cls(origins, sector[order], distance_m[order], slope[order])

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
        if not len(starts):
            return np.zeros(0, np.bool_)
        cluster = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(position)))
        bottom = np.minimum.reduceat(position[:, 2], starts)[cluster]
        sector, distance_m, _ = _seen(position, lidar, self.origins)
        # One point of each sector of a cluster stands for all.
        _, rows = np.unique(np.stack([cluster, sector]), axis=1, return_index=True)
        first = np.searchsorted(self.sector, sector[rows], side="left")
        counts = np.searchsorted(self.sector, sector[rows], side="right") - first
        line = np.repeat(np.arange(len(rows)), counts)
        point = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts) + first[line]
        far_m = distance_m[rows][line]
        meets = self.origins[lidar[rows][line], 2] + self.slope[point] * far_m
        hides = (self.distance_m[point] < NEARER_SHARE * far_m) & (meets >= from_m / 2) & (meets <= bottom[rows][line])
        hidden = np.bincount(line, hides, len(rows)) > 0
        lines = np.bincount(cluster[rows], minlength=len(starts))
        return np.asarray(np.bincount(cluster[rows], hidden, len(starts)) >= HIDDEN_SHARE * lines)


def _seen(position: F64, lidar: I64, origins: F64) -> tuple[I64, F64, F64]:
    """Sector, horizontal distance and slope of the line of sight of points (N, 3)."""
    gap = position - origins[lidar]
    distance_m = np.maximum(np.hypot(gap[:, 0], gap[:, 1]), 1e-9)
    sectors = int(2 * np.pi / SECTOR_RAD) + 2
    sector = ((np.arctan2(gap[:, 1], gap[:, 0]) + np.pi) / SECTOR_RAD).astype(np.int64)
    return lidar * sectors + sector, distance_m, gap[:, 2] / distance_m
