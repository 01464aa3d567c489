"""The search for rectangles by array operations over all clusters at once: the judge of the compiled loops."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.detectors.cluster.lshape import (
    BINS,
    CELLS_ACROSS,
    COARSE_STEP_DEG,
    FINE_STEP_DEG,
    OUTSIDE_SHARE,
    SOFT_SHARE,
    TRIM_SHARE,
    Rectangles,
)

__all__ = ["judged_quantiles", "judged_rectangles"]


def judged_rectangles(xy: F64, starts: I64) -> Rectangles:
    """As `lshape.fit_rectangles`."""
    xy, cluster = xy[:, :2], _cluster_of_row(starts, len(xy))
    thin = _thinned(xy, cluster, starts)
    coarse = np.deg2rad(np.arange(0.0, 90.0, COARSE_STEP_DEG))
    best = coarse[_closeness(np.tile(coarse, (len(starts), 1)), *thin).argmax(1)]
    fine = best[:, None] + np.deg2rad(np.arange(-COARSE_STEP_DEG, COARSE_STEP_DEG + FINE_STEP_DEG / 2, FINE_STEP_DEG))
    angle = np.mod(fine[np.arange(len(starts)), _closeness(fine, *thin).argmax(1)], np.pi / 2)

    cos, sin = np.cos(angle)[cluster], np.sin(angle)[cluster]
    along = np.stack([xy[:, 0] * cos + xy[:, 1] * sin, xy[:, 1] * cos - xy[:, 0] * sin], 1)
    low, high = (
        np.stack([judged_quantiles(along[:, axis], starts, share) for axis in range(2)], 1)
        for share in (OUTSIDE_SHARE, 1 - OUTSIDE_SHARE)
    )
    to_side = np.minimum(np.abs(along - low[cluster]), np.abs(along - high[cluster]))
    square = np.minimum(to_side[:, 0], to_side[:, 1]) ** 2
    residual = np.sqrt(np.add.reduceat(square, starts) / np.diff(starts, append=len(xy)))
    return Rectangles(angle, low, high, residual)


def judged_quantiles(values: F64, starts: I64, share: float) -> F64:
    """As `lshape.quantiles_by_cluster`."""
    lowest, span = float(values.min()), float(np.ptp(values)) + 1.0
    offset = _cluster_of_row(starts, len(values)) * span
    ordered = np.sort(values - lowest + offset)
    last = np.diff(starts, append=len(values)) - 1
    rows = starts + (np.floor(share * last) if share < 0.5 else np.ceil(share * last)).astype(np.int64)
    return np.asarray(ordered[rows] - offset[rows] + lowest)


def _thinned(xy: F64, cluster: I64, starts: I64) -> tuple[F64, F64, I64, I64, F64]:
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
    return means, weights, thin_cluster, thin_starts, SOFT_SHARE * diagonal_m


def _closeness(angles: F64, xy: F64, weights: F64, cluster: I64, starts: I64, soft_m: F64) -> F64:
    cos, sin = np.cos(angles)[cluster], np.sin(angles)[cluster]
    x, y = xy[:, :1], xy[:, 1:]
    along, across = (
        _side_distance(place, weights, cluster, starts) for place in (x * cos + y * sin, y * cos - x * sin)
    )
    soft = np.sqrt(np.minimum(along, across) ** 2 + soft_m[cluster, None] ** 2)
    return np.asarray(np.add.reduceat(weights[:, None] / soft, starts))


def _side_distance(along: F64, weights: F64, cluster: I64, starts: I64) -> F64:
    low = np.minimum.reduceat(along, starts)
    step = np.maximum((np.maximum.reduceat(along, starts) - low) / BINS, 1e-9)
    bins = np.minimum((along - low[cluster]) / step[cluster], BINS - 1).astype(np.int64)
    histogram = (cluster[:, None] * along.shape[1] + np.arange(along.shape[1])) * BINS + bins
    repeated = np.repeat(weights, along.shape[1])
    mass = np.bincount(histogram.ravel(), repeated, minlength=low.size * BINS).reshape(*low.shape, BINS).cumsum(2)
    outside = TRIM_SHARE * mass[..., -1:]
    first = (mass <= outside).sum(2)
    last = (mass < mass[..., -1:] - outside).sum(2) + 1
    low, high = (low + first * step)[cluster], (low + last * step)[cluster]
    return np.asarray(np.minimum(np.abs(along - low), np.abs(along - high)))


def _cluster_of_row(starts: I64, rows: int) -> I64:
    return np.repeat(np.arange(len(starts)), np.diff(starts, append=rows))
