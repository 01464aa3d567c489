"""The sums of `rotated_iou.py`, compiled: one pass over the pairs."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled, inlined

__all__ = ["shared_grounds"]

_LIST, _TABLE = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@inlined
def _clipped(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@inlined
def _mean_clipped(start: float, end: float, limit: float) -> float:
    """Mean of the numbers from `start` to `end`, each of them clipped to -`limit` .. `limit`."""
    low, high = min(start, end), max(start, end)
    within_low, within_high = _clipped(low, limit), _clipped(high, limit)
    if not high > low:
        return within_low
    above, below = max(high, limit) - max(low, limit), min(high, -limit) - min(low, -limit)
    return ((within_high - within_low) * (within_high + within_low) / 2 + limit * (above - below)) / (high - low)


@compiled(f"float64[::1]({_TABLE}, {_TABLE}, {_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_LIST}, {_LIST}, float64)")
def shared_grounds(
    centers: F64,
    sizes: F64,
    other_centers: F64,
    other_sizes: F64,
    cos: F64,
    sin: F64,
    turn_cos: F64,
    turn_sin: F64,
    rounding: float,
) -> F64:
    """(P,) ground that two boxes share, square metres; see `rotated_iou.shared_ground`.

    The integral over x, in the frame of the first box, of the height y that lies in both rectangles. Above each x, the
    second rectangle reaches from one of its edges up to another; both are cut off where the first one ends. So what its
    edges contribute, each with the sign of its direction, adds up to the area. No polygon is made whose corners could
    be confused where edges and corners meet: the area is continuous in what is given.

    Args:
        centers: (P, 3) of the first boxes.
        sizes: (P, 3).
        other_centers: (P, 3) of the second boxes.
        other_sizes: (P, 3).
        cos: (P,) of the yaws of the first boxes.
        sin: (P,) of these.
        turn_cos: (P,) of the yaws of the second boxes less those of the first.
        turn_sin: (P,) of these.
        rounding: Boxes that share less than this part of the sum of their grounds share nothing.
    """
    shared = np.zeros(len(cos))
    x, y = np.empty(5), np.empty(5)
    for p in range(len(cos)):
        ground, other_ground = sizes[p, 0] * sizes[p, 1], other_sizes[p, 0] * other_sizes[p, 1]
        half_length, half_width = sizes[p, 0] / 2, sizes[p, 1] / 2
        if not (sizes[p, 0] > 0 and sizes[p, 1] > 0 and other_sizes[p, 0] > 0 and other_sizes[p, 1] > 0):
            continue
        east, north = other_centers[p, 0] - centers[p, 0], other_centers[p, 1] - centers[p, 1]
        for k in range(5):  # the corners, counter-clockwise, and the first once more
            along = other_sizes[p, 0] / 2 * (1.0 if k % 4 == 0 or k % 4 == 3 else -1.0)
            across = other_sizes[p, 1] / 2 * (1.0 if k % 4 < 2 else -1.0)
            x[k] = east * cos[p] + north * sin[p] + along * turn_cos[p] - across * turn_sin[p]
            y[k] = north * cos[p] - east * sin[p] + along * turn_sin[p] + across * turn_cos[p]
        area = 0.0
        for k in range(4):
            left, right = _clipped(x[k], half_length), _clipped(x[k + 1], half_length)
            way_x, way_y = 1.0 if x[k + 1] == x[k] else x[k + 1] - x[k], y[k + 1] - y[k]
            left_y = y[k] + min(max((left - x[k]) / way_x, 0.0), 1.0) * way_y
            right_y = y[k + 1] - min(max((x[k + 1] - right) / way_x, 0.0), 1.0) * way_y
            area += (left - right) * _mean_clipped(left_y, right_y, half_width)
        area = min(area, min(ground, other_ground))
        if area > rounding * (ground + other_ground):
            shared[p] = area
    return shared
