"""Oriented rectangles around clusters seen from above, by search over the heading.

A lidar sees the near sides of a car: an L, or one line. The heading chosen is the one at which the points lie closest
to the sides of their bounding rectangle (X. Zhang, W. Xu, C. Dong, J. M. Dolan: Efficient L-shape fitting for vehicle
detection using laser scanners, IEEE Intelligent Vehicles Symposium 2017; closeness criterion). Unlike there, all four
sides count, because several lidars may see them all, and a small share of the points may lie outside, such as mirrors
and stray points. All clusters are fitted at once.

Of points (N, 2 or more), x and y count, metres; they are sorted by cluster, and `starts` (C,) are the first rows of the
clusters. There is at least one cluster, and each has at least one point.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.compiled import compiled, inlined

COARSE_STEP_DEG = 3.0
FINE_STEP_DEG = 0.5

SOFT_SHARE = 0.08
"""Distance from a side, as a share of the cluster's diagonal, that hardly lowers closeness: sides are rounded."""

CELLS_ACROSS = 24
"""Cells along the diagonal of a cluster that is thinned before the search."""

BINS = 48
"""Resolution of the bounds during the search, along a cluster."""

TRIM_SHARE = 0.04
"""Maximum share of the points outside at each side during the search."""

OUTSIDE_SHARE = 0.01
"""Maximum share of the points outside at each side of the final rectangle."""

_COARSE_RAD = np.deg2rad(np.arange(0.0, 90.0, COARSE_STEP_DEG))
_FINE_RAD = np.deg2rad(np.arange(-COARSE_STEP_DEG, COARSE_STEP_DEG + FINE_STEP_DEG / 2, FINE_STEP_DEG))
_ANGLES_RAD = np.append(_COARSE_RAD, _COARSE_RAD[:, None] + _FINE_RAD)
_COS, _SIN = np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)
"""The directions that are tried: coarse ones, then the fine ones about each of these in turn."""


@dataclass(frozen=True, eq=False)
class Rectangles:
    """Bounding rectangles of C clusters, seen from above."""

    angle_rad: F64  # (C,) float64 angle of the first axis about +z, in [0, pi/2)
    low: F64  # (C, 2) float64 lower ends along the first and second axis (rotated coordinates), metres
    high: F64  # (C, 2) float64 upper ends, metres
    residual_m: F64  # (C,) float64 root mean square distance of the points from their nearest sides


def fit_rectangles(xy: F64, starts: I64) -> Rectangles:
    """Fit a rectangle to each cluster."""
    xy, ends = np.ascontiguousarray(xy), _ends_of(starts, len(xy))
    low = np.minimum.reduceat(xy[:, :2], starts)
    diagonal_m = np.maximum(np.hypot(*(np.maximum.reduceat(xy[:, :2], starts) - low).T), 1e-3)
    count, means, weights, mean_ends = _thinned(xy, ends, low, diagonal_m / CELLS_ACROSS, CELLS_ACROSS + 1)
    thin = means[:count], weights[:count], mean_ends, SOFT_SHARE * diagonal_m
    best = _closest_directions(*thin, _COS, _SIN, len(_COARSE_RAD), BINS, TRIM_SHARE)
    return rectangles_along(xy, starts, _ANGLES_RAD.take(best))


def rectangles_along(xy: F64, starts: I64, angles_rad: F64) -> Rectangles:
    """The rectangle around each cluster with a side in a given direction (C,), about +z."""
    angle = np.mod(angles_rad, np.pi / 2)
    ends = _ends_of(starts, len(xy))
    return Rectangles(angle, *_rectangles(np.ascontiguousarray(xy), ends, np.cos(angle), np.sin(angle), OUTSIDE_SHARE))


def quantiles_by_cluster(values: F64, starts: I64, share: float) -> F64:
    """(C,) a quantile of each cluster's values (N,).

    It is rounded outwards to the next value, so that a cluster of few points loses none of its extent.
    """
    return _quantiles(np.ascontiguousarray(values), _ends_of(starts, len(values)), share)


def principal_axes(xy: F64, starts: I64) -> tuple[F64, F64]:
    """(C,) angle about +z of the principal axis of each cluster, in (-pi/2, pi/2]; (C,) its roundness, in [0, 1].

    The principal axis is the direction in which points are spread most. A cyclist is no rectangle: thin wheels at both
    ends, a rider as wide as the handlebars in the middle. The rectangle to whose sides the points lie closest runs
    along the lines from shoulder to wheel, 14 degrees off the heading in the median of simulated recordings; the
    principal axis is 3 degrees off. Roundness is the standard deviation across the axis, as a share of that along it;
    1 for a single point.
    """
    counts = np.diff(starts, append=len(xy))
    mean = np.add.reduceat(xy[:, :2], starts) / counts[:, None]
    x, y = (xy[:, :2] - np.repeat(mean, counts, axis=0)).T
    xx, xy_, yy = np.add.reduceat(np.stack([x * x, x * y, y * y]), starts, axis=1) / counts
    apart = np.hypot((xx - yy) / 2, xy_)
    largest, smallest = (xx + yy) / 2 + apart, np.maximum((xx + yy) / 2 - apart, 0.0)
    roundness = np.sqrt(np.divide(smallest, largest, out=np.ones_like(largest), where=largest > 0))
    return np.arctan2(2 * xy_, xx - yy) / 2, roundness


def _ends_of(starts: I64, count: int) -> I64:
    """(C,) row behind the last of each cluster."""
    return np.append(starts[1:], count)


@compiled(
    "Tuple((int64, float64[:, ::1], float64[::1], int64[::1]))"
    "(float64[:, ::1], int64[::1], float64[:, ::1], float64[::1], int64)"
)
def _thinned(xy: F64, ends: I64, low: F64, cell_m: F64, across: int) -> tuple[int, F64, F64, I64]:
    """Means of the points in the cells of each cluster's own grid, in the order of the cells.

    Returns:
        The number M of means; room for N means (N, 2) and for the number of points of each (N,), the first M are used;
        and (C,) the row behind the last mean of each cluster.
    """
    count = len(xy)
    means, weights, mean_ends = np.empty((count, 2)), np.empty(count), np.empty(len(ends), np.int64)
    cell, x, y = np.empty(count, np.int64), np.empty(count), np.empty(count)
    place = np.empty(across * across + 1, np.int64)
    start, made = 0, 0
    for c in range(len(ends)):
        for k in range(len(place)):
            place[k] = 0
        for i in range(start, ends[c]):
            column = int((xy[i, 0] - low[c, 0]) / cell_m[c])
            cell[i] = column * across + int((xy[i, 1] - low[c, 1]) / cell_m[c])
            place[cell[i] + 1] += 1
        for k in range(1, len(place)):
            place[k] += place[k - 1]
        for i in range(start, ends[c]):
            to = start + place[cell[i]]
            x[to], y[to] = xy[i, 0], xy[i, 1]
            place[cell[i]] += 1
        first = start  # each place is the end of its cell now
        for k in range(across * across):
            size = start + place[k] - first
            if size > 0:
                east, north = 0.0, 0.0
                for i in range(first, first + size):
                    east, north = east + x[i], north + y[i]
                means[made, 0], means[made, 1], weights[made] = east / size, north / size, size
                made += 1
                first += size
        mean_ends[c] = made
        start = ends[c]
    return made, means, weights, mean_ends


@inlined
def _range(values: F64, count: int) -> tuple[float, float]:
    """The least and the largest of the first values."""
    low = high = values[0]
    for i in range(1, count):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high


@inlined
def _ends(mass: F64, total: float, outside: float, low: float, step: float) -> tuple[float, float]:
    """The two ends of a histogram with at most the mass `outside` behind either; masses are whole, and sums exact."""
    first, last, below, above, inside = 0, len(mass), mass[0], mass[-1], total - outside
    while below <= outside:
        first += 1
        below += mass[first]
    while total - above >= inside:
        last -= 1
        above += mass[last - 1]
    return low + first * step, low + last * step


@compiled(
    "int64[::1](float64[:, ::1], float64[::1], int64[::1], float64[::1], float64[::1], float64[::1], int64, int64, "
    "float64)"
)
def _closest_directions(
    xy: F64, weights: F64, ends: I64, soft_m: F64, cos: F64, sin: F64, coarse: int, bins: int, trim_share: float
) -> I64:
    """(C,) the direction in which the points of each cluster are closest to the sides of their bounding rectangle.

    The best one of the coarse directions, then of the fine ones about that, which follow all coarse ones in `cos` and
    `sin`; of those alike the first.
    """
    xs, ys = np.empty(len(xy)), np.empty(len(xy))
    for i in range(len(xy)):
        xs[i], ys[i] = xy[i, 0], xy[i, 1]
    found, mass, mass_left = np.empty(len(ends), np.int64), np.empty(bins), np.empty(bins)
    forward, left, near = np.empty(len(xy)), np.empty(len(xy)), np.empty(len(xy))
    bin_forward, bin_left = np.empty(len(xy), np.int32), np.empty(len(xy), np.int32)
    start, fine = 0, len(cos) // coarse - 1
    for c in range(len(ends)):
        count, soft, total = ends[c] - start, soft_m[c] * soft_m[c], 0.0
        own, east, north = weights[start : ends[c]], xs[start : ends[c]], ys[start : ends[c]]
        for i in range(count):
            total += own[i]
        best, closest, skipped = 0, -np.inf, 0
        for k in range(coarse + fine):
            if k == coarse:
                skipped, closest = best * fine, -np.inf
            x, y = cos[skipped + k], sin[skipped + k]
            for i in range(count):
                forward[i] = east[i] * x + north[i] * y
                left[i] = north[i] * x - east[i] * y
            low, high = _range(forward, count)
            low_left, high_left = _range(left, count)
            step, step_left = max((high - low) / bins, 1e-9), max((high_left - low_left) / bins, 1e-9)
            for one in range(bins):
                mass[one], mass_left[one] = 0.0, 0.0
            for i in range(count):
                bin_forward[i] = np.int32(min((forward[i] - low) / step, bins - 1.0))
                bin_left[i] = np.int32(min((left[i] - low_left) / step_left, bins - 1.0))
            for i in range(count):
                mass[np.uint32(bin_forward[i])] += own[i]
                mass_left[np.uint32(bin_left[i])] += own[i]
            low, high = _ends(mass, total, trim_share * total, low, step)
            low_left, high_left = _ends(mass_left, total, trim_share * total, low_left, step_left)
            for i in range(count):
                gap = min(abs(forward[i] - low), abs(forward[i] - high))
                gap = min(gap, min(abs(left[i] - low_left), abs(left[i] - high_left)))
                near[i] = own[i] / np.sqrt(gap * gap + soft)
            closeness = 0.0
            for i in range(count):
                closeness += near[i]
            if closeness > closest:
                best, closest = skipped + k, closeness
        found[c] = best
        start = ends[c]
    return found


@compiled("float64[::1](float64[::1], int64[::1], float64)")
def _quantiles(values: F64, ends: I64, share: float) -> F64:
    """(C,) see `quantiles_by_cluster`; ten times as fast as a partition, as shares are near one of the ends."""
    found, best, start = np.empty(len(ends)), np.empty(len(values)), 0
    for c in range(len(ends)):
        size = ends[c] - start
        rank = int(np.floor(share * (size - 1)) if share < 0.5 else np.ceil(share * (size - 1)))
        sign, wanted = 1.0, rank + 1
        if rank > size // 2:
            sign, wanted = -1.0, size - rank  # from the top
        for k in range(wanted):
            best[k] = np.inf
        for i in range(start, ends[c]):
            value, k = sign * values[i], wanted - 1
            if value < best[k]:
                while k > 0 and best[k - 1] > value:
                    best[k] = best[k - 1]
                    k -= 1
                best[k] = value
        found[c] = sign * best[wanted - 1]
        start = ends[c]
    return found


@compiled(
    "Tuple((float64[:, ::1], float64[:, ::1], float64[::1]))"
    "(float64[:, ::1], int64[::1], float64[::1], float64[::1], float64)"
)
def _rectangles(xy: F64, ends: I64, cos: F64, sin: F64, outside_share: float) -> tuple[F64, F64, F64]:
    """Lower and upper ends of the rectangle around each cluster along its axes, (C, 2); and its residual (C,)."""
    along, start = np.empty((2, len(xy))), 0
    for c in range(len(ends)):
        for i in range(start, ends[c]):
            along[0, i] = xy[i, 0] * cos[c] + xy[i, 1] * sin[c]
            along[1, i] = xy[i, 1] * cos[c] - xy[i, 0] * sin[c]
        start = ends[c]
    low, high, residual_m = np.empty((len(ends), 2)), np.empty((len(ends), 2)), np.empty(len(ends))
    for axis in range(2):
        low[:, axis] = _quantiles(along[axis], ends, outside_share)
        high[:, axis] = _quantiles(along[axis], ends, 1.0 - outside_share)
    start = 0
    for c in range(len(ends)):
        square = 0.0
        for i in range(start, ends[c]):
            first = min(abs(along[0, i] - low[c, 0]), abs(along[0, i] - high[c, 0]))
            second = min(abs(along[1, i] - low[c, 1]), abs(along[1, i] - high[c, 1]))
            square += min(first, second) * min(first, second)
        residual_m[c] = np.sqrt(square / (ends[c] - start))
        start = ends[c]
    return low, high, residual_m
