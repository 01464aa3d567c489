"""Oriented rectangles around clusters seen from above, by search over the heading.

A lidar sees the near sides of a car: an L, or one line. The heading chosen is the one at which the points lie closest
to the sides of their bounding rectangle (X. Zhang, W. Xu, C. Dong, J. M. Dolan: Efficient L-shape fitting for vehicle
detection using laser scanners, IEEE Intelligent Vehicles Symposium 2017; closeness criterion). Unlike there, all four
sides count, because several lidars may see them all, and a small share of the points may lie outside, such as mirrors
and stray points. All clusters are fitted at once.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.geometry.boxes import rotations_2d

__all__ = ["Rectangles", "fit_rectangles", "quantiles_by_cluster", "rectangles_along"]


COARSE_STEP_DEG = 3.0
FINE_STEP_DEG = 0.5

SOFT_SHARE = 0.08
"""Distance from a side, as a share of the cluster's diagonal, that hardly lowers closeness: sides are rounded."""

CELLS_ACROSS = 24
"""A cluster is thinned to this many cells along its diagonal before the search."""

BINS = 48
"""Resolution of the bounds during the search, along a cluster."""

TRIM_SHARE = 0.04
"""Share of the points that may lie outside at each side during the search."""

OUTSIDE_SHARE = 0.01
"""Share of the points outside at each side of the final rectangle."""


@dataclass(frozen=True, eq=False)
class Rectangles:
    """Bounding rectangles of C clusters, seen from above.

    Attributes:
        angle_rad: (C,) float64 angle of the first axis about +z, in [0, pi/2).
        low: (C, 2) float64 lower ends along the first and second axis (rotated coordinates), metres.
        high: (C, 2) float64 upper ends, metres.
        residual_m: (C,) float64 root mean square distance of the points from their nearest sides.
    """

    angle_rad: F64
    low: F64
    high: F64
    residual_m: F64

    @property
    def axes(self) -> F64:
        """(C, 2, 2): unit vector of each axis, x and y."""
        return rotations_2d(-self.angle_rad)


def fit_rectangles(xy: F64, starts: I64) -> Rectangles:
    """Fit a rectangle to each cluster.

    Args:
        xy: (N, 2) metres, sorted by cluster.
        starts: (C,) first row of each cluster; each has at least one, and there is at least one cluster.
    """
    cluster = _cluster_of_row(starts, len(xy))
    thin = _Thinned.of(xy, cluster, starts)
    rows = np.arange(len(starts))
    coarse = np.deg2rad(np.arange(0.0, 90.0, COARSE_STEP_DEG))
    best = coarse[thin.closeness(np.tile(coarse, (len(starts), 1))).argmax(1)]
    fine = best[:, None] + np.deg2rad(np.arange(-COARSE_STEP_DEG, COARSE_STEP_DEG + FINE_STEP_DEG / 2, FINE_STEP_DEG))
    return rectangles_along(xy, starts, fine[rows, thin.closeness(fine).argmax(1)])


def rectangles_along(xy: F64, starts: I64, angles_rad: F64) -> Rectangles:
    """The rectangle around each cluster with a side in a given direction.

    Args:
        xy: (N, 2) metres, sorted by cluster.
        starts: (C,) first row of each cluster; each has at least one, and there is at least one cluster.
        angles_rad: (C,) direction of one side about +z.
    """
    angle, cluster = np.mod(angles_rad, np.pi / 2), _cluster_of_row(starts, len(xy))
    cos, sin = np.cos(angle)[cluster], np.sin(angle)[cluster]
    along = np.stack([xy[:, 0] * cos + xy[:, 1] * sin, xy[:, 1] * cos - xy[:, 0] * sin], 1)
    ends = [quantiles_by_cluster(along[:, axis], starts, (OUTSIDE_SHARE, 1 - OUTSIDE_SHARE)) for axis in range(2)]
    low, high = np.stack(ends, 2)
    to_side = np.minimum(np.abs(along - low[cluster]), np.abs(along - high[cluster]))
    square = np.minimum(to_side[:, 0], to_side[:, 1]) ** 2
    residual = np.sqrt(np.add.reduceat(square, starts) / np.diff(starts, append=len(xy)))
    return Rectangles(angle, low, high, residual)


def quantiles_by_cluster(values: F64, starts: I64, shares: tuple[float, ...]) -> F64:
    """(S, C) quantiles of each cluster's values.

    Rounded outwards to the next value, so that a cluster of few points loses none of its extent.

    Args:
        values: (N,) sorted by cluster, in any order within.
        starts: (C,) first row of each cluster.
        shares: (S,) in [0, 1].
    """
    lowest, span = float(values.min()), float(np.ptp(values)) + 1.0
    offset = _cluster_of_row(starts, len(values)) * span
    ordered = np.sort(values - lowest + offset)
    last = np.diff(starts, append=len(values)) - 1
    steps = [np.floor(share * last) if share < 0.5 else np.ceil(share * last) for share in shares]
    rows = starts + np.array(steps).astype(np.int64)
    return np.asarray(ordered[rows] - offset[rows] + lowest)


@dataclass(frozen=True, eq=False)
class _Thinned:
    """Clusters as weighted points.

    Attributes:
        xy: (M, 2) metres, sorted by cluster.
        weights: (M,) number of points that each one stands for.
        cluster: (M,).
        starts: (C,) first row of each cluster.
        soft_m: (C,) distance from a side that hardly lowers closeness.
    """

    xy: F64
    weights: F64
    cluster: I64
    starts: I64
    soft_m: F64

    @classmethod
    def of(cls, xy: F64, cluster: I64, starts: I64) -> "_Thinned":
        """Means of the points in the cells of a grid of each cluster's own size."""
        columns = np.ascontiguousarray(xy.T)
        low = np.minimum.reduceat(columns, starts, axis=1)
        diagonal_m = np.maximum(np.hypot(*(np.maximum.reduceat(columns, starts, axis=1) - low)), 1e-3)
        cell = ((columns - low[:, cluster]) / (diagonal_m / CELLS_ACROSS)[cluster]).astype(np.int64)
        side = CELLS_ACROSS + 1
        key = (cluster * side + cell[0]) * side + cell[1]
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        weights = np.diff(first, append=len(key)).astype(np.float64)
        means = (np.add.reduceat(columns.take(order, axis=1), first, axis=1) / weights).T
        thin_cluster = cluster[order[first]]
        thin_starts = np.searchsorted(thin_cluster, np.arange(len(starts)))
        return cls(means, weights, thin_cluster, thin_starts, SOFT_SHARE * diagonal_m)

    def closeness(self, angles: F64) -> F64:
        """(C, A) closeness of the points of each cluster to the bounding rectangle at each of its angles (C, A)."""
        cos, sin = np.cos(angles)[self.cluster], np.sin(angles)[self.cluster]
        x, y = self.xy[:, :1], self.xy[:, 1:]
        to_side = np.minimum(self._side_distance(x * cos + y * sin), self._side_distance(y * cos - x * sin))
        soft = np.sqrt(to_side**2 + self.soft_m[self.cluster, None] ** 2)
        return np.asarray(np.add.reduceat(self.weights[:, None] / soft, self.starts))

    def _side_distance(self, along: F64) -> F64:
        """(M, A) distance from the nearer of the two trimmed ends of the cluster."""
        low = np.minimum.reduceat(along, self.starts)
        step = np.maximum((np.maximum.reduceat(along, self.starts) - low) / BINS, 1e-9)
        bins = np.minimum((along - low[self.cluster]) / step[self.cluster], BINS - 1).astype(np.int64)
        histogram = (self.cluster[:, None] * along.shape[1] + np.arange(along.shape[1])) * BINS + bins
        weights = np.repeat(self.weights, along.shape[1])
        mass = np.bincount(histogram.ravel(), weights, minlength=low.size * BINS).reshape(*low.shape, BINS).cumsum(2)
        outside = TRIM_SHARE * mass[..., -1:]
        first = (mass <= outside).sum(2)
        last = (mass < mass[..., -1:] - outside).sum(2) + 1
        low, high = (low + first * step)[self.cluster], (low + last * step)[self.cluster]
        return np.asarray(np.minimum(np.abs(along - low), np.abs(along - high)))


def _cluster_of_row(starts: I64, rows: int) -> I64:
    return np.repeat(np.arange(len(starts)), np.diff(starts, append=rows))
