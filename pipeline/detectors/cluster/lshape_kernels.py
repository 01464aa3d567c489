"""The loops of `lshape.py` over the points of each cluster."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["closest_directions", "quantiles", "rectangles", "thinned"]


@compiled(
    "Tuple((int64, float64[:, ::1], float64[::1], int64[::1]))"
    "(float64[:, ::1], int64[::1], float64[:, ::1], float64[::1], int64)"
)
def thinned(xy: F64, ends: I64, low: F64, cell_m: F64, across: int) -> tuple[int, F64, F64, I64]:
    """Means of the points in the cells of each cluster's own grid, in the order of the cells.

    Args:
        xy: (N, 2 or more) of which x and y count, metres; sorted by cluster.
        ends: (C,) row behind the last of each cluster.
        low: (C, 2) corner of each grid.
        cell_m: (C,) edge of its cells.
        across: Number of cells along either side of each grid.

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
    """The least and the largest of the first values; four at once, none of which waits for another."""
    a = b = c = d = e = f = g = h = values[0]
    stop = count - count % 4
    for i in range(0, stop, 4):
        a, b, c, d = min(a, values[i]), min(b, values[i + 1]), min(c, values[i + 2]), min(d, values[i + 3])
        e, f, g, h = max(e, values[i]), max(f, values[i + 1]), max(g, values[i + 2]), max(h, values[i + 3])
    for i in range(stop, count):
        a, e = min(a, values[i]), max(e, values[i])
    return min(min(a, b), min(c, d)), max(max(e, f), max(g, h))


@inlined
def _ends(mass: F64, total: float, outside: float, low: float, step: float) -> tuple[float, float]:
    """The two ends of a histogram, behind which little lies.

    Args:
        mass: Of each bin: a whole number, so that sums are exact.
        total: Of all bins.
        outside: Largest mass behind either end; less than all.
        low: Where the first bin begins.
        step: Width of each.
    """
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
def closest_directions(
    xy: F64, weights: F64, ends: I64, soft_m: F64, cos: F64, sin: F64, coarse: int, bins: int, trim_share: float
) -> I64:
    """(C,) the direction in which the points of each cluster are closest to the sides of their bounding rectangle.

    The best one of the coarse directions, then of the fine ones about that; of those alike the first.

    Args:
        xy: (M, 2) points, sorted by cluster.
        weights: (M,) number of measured points that each stands for.
        ends: (C,) row behind the last point of each cluster.
        soft_m: (C,) distance from a side that hardly lowers closeness.
        cos: (A + A * F,) of the directions: coarse ones, then the fine ones about each of these in turn.
        sin: (A + A * F,) of the same.
        coarse: Their number A.
        bins: Resolution of the bounds.
        trim_share: Share of the points that may lie outside at each side.
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
def quantiles(values: F64, ends: I64, share: float) -> F64:
    """(C,) a quantile of each cluster's values, rounded outwards to the next value.

    Args:
        values: (N,) at least one; sorted by cluster, in any order within.
        ends: (C,) row behind the last of each.
        share: In [0, 1], near one of the ends.
    """
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
def rectangles(xy: F64, ends: I64, cos: F64, sin: F64, outside_share: float) -> tuple[F64, F64, F64]:
    """Lower and upper ends of the rectangle around each cluster along its axes, (C, 2); and its residual (C,).

    Args:
        xy: (N, 2 or more) of which x and y count, metres; sorted by cluster.
        ends: (C,) row behind the last point of each cluster.
        cos: (C,) of the angle of the first axis.
        sin: (C,) of the same.
        outside_share: Share of the points outside at each side.
    """
    along, start = np.empty((2, len(xy))), 0
    for c in range(len(ends)):
        for i in range(start, ends[c]):
            along[0, i] = xy[i, 0] * cos[c] + xy[i, 1] * sin[c]
            along[1, i] = xy[i, 1] * cos[c] - xy[i, 0] * sin[c]
        start = ends[c]
    low, high, residual_m = np.empty((len(ends), 2)), np.empty((len(ends), 2)), np.empty(len(ends))
    for axis in range(2):
        low[:, axis] = quantiles(along[axis], ends, outside_share)
        high[:, axis] = quantiles(along[axis], ends, 1.0 - outside_share)
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
