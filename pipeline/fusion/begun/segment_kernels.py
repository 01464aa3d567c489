"""The loops of `segments.py` over points, segment by segment."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["extents_of_segments", "points_of_segments"]

_ROWS, _LIST = "Array(int64, 1, 'C', True)", "Array(float64, 1, 'C', True)"


@inlined
def _ranked(values: F64, count: int, rank: int) -> float:
    """Of the first values, which change places, the one that comes after so many (C. A. R. Hoare: Find, 1961)."""
    low, high = 0, count - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < rank < i:
            break
        low, high = (i, high) if rank >= i else (low, j)
    found: float = values[rank]
    return found


@compiled(
    "Tuple((int64[::1], int64[::1], int64[::1], int64[::1], float64[::1], float64[::1], float64[::1]))"
    f"({_ROWS}, int64, {_ROWS}, {_LIST}, {_LIST}, {_LIST}, {_LIST})"
)
def extents_of_segments(
    segment: I64, count: int, group: I64, along_m: F64, share_x: F64, share_y: F64, reach_m: F64
) -> tuple[I64, I64, I64, I64, F64, F64, F64]:
    """Points sorted by their segment, and what each segment extends over, as far as an object of its frustum reaches.

    The front is where the nearest tenth of the points ends: one stray point is not an object's side.

    Args:
        segment: (P,) of each point, from 0; each of them has one.
        count: The number S of segments.
        group: (P,) frustum of each point; those of a segment are of one.
        along_m: (P,) see `FrustumPoints`.
        share_x: (P,) see there.
        share_y: (P,) see there.
        reach_m: (F,) how far behind the front points of an object may lie.

    Returns:
        (P,) rows of the points, (S + 1,) the first of them of each segment; (S,) its frustum, number of points within
        reach, front, and extents in `share_x` and `share_y`.
    """
    starts, place = np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    for own in segment:
        starts[own + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
        place[s] = starts[s]
    order = np.empty(len(segment), np.int64)
    for i in range(len(segment)):
        order[place[segment[i]]] = i
        place[segment[i]] += 1
    frustum, within = np.empty(count, np.int64), np.zeros(count, np.int64)
    front, wide, high, own_m = np.empty(count), np.empty(count), np.empty(count), np.empty(len(segment))
    for s in range(count):
        rows = order[starts[s] : starts[s + 1]]
        for i in range(len(rows)):
            own_m[i] = along_m[rows[i]]
        frustum[s], front[s] = group[rows[0]], _ranked(own_m, len(rows), len(rows) // 10)
        low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
        for i in rows:
            if along_m[i] <= front[s] + reach_m[frustum[s]]:
                within[s] += 1
                low_x, high_x = min(low_x, share_x[i]), max(high_x, share_x[i])
                low_y, high_y = min(low_y, share_y[i]), max(high_y, share_y[i])
        wide[s], high[s] = high_x - low_x, high_y - low_y
    return order, starts, frustum, within, front, wide, high


@compiled(f"Tuple((int64[::1], int64[::1]))({_ROWS}, {_ROWS}, {_ROWS}, {_LIST}, {_LIST})")
def points_of_segments(chosen: I64, order: I64, starts: I64, along_m: F64, ends_m: F64) -> tuple[I64, I64]:
    """(Q,) rows of the points of some segments, in their order, and (G,) the first of these of each segment.

    Args:
        chosen: (G,) the segments.
        order: (P,) rows of the points, sorted by their segment.
        starts: (S + 1,) first of them of each segment.
        along_m: (P,) of the points.
        ends_m: (S,) points of a segment behind this are left out.
    """
    rows, first, count = np.empty(len(order), np.int64), np.empty(len(chosen), np.int64), 0
    for g in range(len(chosen)):
        first[g] = count
        for i in order[starts[chosen[g]] : starts[chosen[g] + 1]]:
            if along_m[i] <= ends_m[chosen[g]]:
                rows[count] = i
                count += 1
    return rows[:count].copy(), first
