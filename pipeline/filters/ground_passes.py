"""What finding the ground does with all points, each in one compiled pass: see `pipeline.core.compiled`.

The same as `pipeline.filters.ground_arrays`, where the functions are explained; sums run in the order of the points.
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["count_layers", "heights_within", "lowest_of_cells", "scatter_within"]


MAX_CELL = 2.0**30
"""As in `ground_arrays`."""

SPREAD = np.uint64(0x9E3779B97F4A7C15)
"""Numbers times this differ in their upper bits (D. E. Knuth: The art of computer programming, vol. 3, 6.4)."""


def lowest_of_cells(points: F32, cell_m: np.float32) -> I64:
    """(M,) row of the lowest point of each occupied cell, ordered by cell."""
    cells, rows = _lowest(points, cell_m)
    return rows[np.argsort(cells)]


@inlined
def _cell(place: np.float32, cell_m: np.float32) -> np.int64:
    return np.int64(min(max(np.floor(place / cell_m), -MAX_CELL), MAX_CELL))


@compiled("Tuple((int64[::1], int64[::1]))(float32[:, ::1], float32)")
def _lowest(points: F32, cell_m: np.float32) -> tuple[I64, I64]:
    """(M,) occupied cells, in the order in which they are met, and (M,) the row of the lowest point of each."""
    count = points.shape[1]
    slots, shift = 64, np.uint64(58)
    while slots < 2 * count:
        slots, shift = 2 * slots, shift - np.uint64(1)
    in_slot, cells, rows = np.full(slots, -1, np.int32), np.empty(count, np.int64), np.empty(count, np.int64)
    found = 0
    for i in range(count):
        cell = _cell(points[0, i], cell_m) * np.int64(2 * MAX_CELL + 1) + _cell(points[1, i], cell_m)
        slot = np.int64((np.uint64(cell) * SPREAD) >> shift)
        while in_slot[slot] >= 0 and cells[in_slot[slot]] != cell:
            slot = (slot + 1) & (slots - 1)
        at = in_slot[slot]
        if at < 0:
            in_slot[slot], cells[found], rows[found] = found, cell, i
            found += 1
        elif points[2, i] < points[2, rows[at]]:
            rows[at] = i
    return cells[:found], rows[:found]


@inlined
def _height(points: F32, i: int, plane: F32) -> np.float32:
    height: np.float32 = points[0, i] * plane[0] + points[1, i] * plane[1] + points[2, i] * plane[2] + plane[3]
    return height


@compiled("Tuple((int64[::1], int64[::1]))(float32[:, ::1], float32[:, ::1], float32)")
def count_layers(points: F32, planes: F32, layer_m: np.float32) -> tuple[I64, I64]:
    """(K,) number of points in each plane's layer, and in the fuller of those beside it."""
    held, beside = np.empty(len(planes), np.int64), np.empty(len(planes), np.int64)
    thrice_m = np.float32(3) * layer_m
    for k in range(len(planes)):
        plane = planes[k]
        deep = low = high = top = 0
        for i in range(points.shape[1]):
            height = _height(points, i, plane)
            deep += 1 if height <= -thrice_m else 0
            low += 1 if height <= -layer_m else 0
            high += 1 if height <= layer_m else 0
            top += 1 if height <= thrice_m else 0
        held[k] = high - low
        beside[k] = max(low - deep, top - high)
    return held, beside


@compiled("float32[::1](float32[:, ::1], float32[::1], float32)")
def heights_within(points: F32, plane: F32, limit_m: np.float32) -> F32:
    """(M,) distances from a plane, of those that are at most `limit_m`."""
    within = np.empty(points.shape[1], np.float32)
    count = 0
    for i in range(points.shape[1]):
        height = abs(_height(points, i, plane))
        within[count] = height  # written over by the next one if it is too far
        count += 1 if height <= limit_m else 0
    return within[:count]


@compiled("Tuple((float64[::1], float64[:, ::1]))(float32[:, ::1], float32[::1], float32)")
def scatter_within(points: F32, plane: F32, limit_m: np.float32) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of the points at most `limit_m` from a plane."""
    near = np.empty(points.shape[1], np.int32)
    count = 0
    x_sum = y_sum = z_sum = 0.0
    for i in range(points.shape[1]):
        if abs(_height(points, i, plane)) <= limit_m:
            near[count] = i
            count += 1
            x_sum += points[0, i]
            y_sum += points[1, i]
            z_sum += points[2, i]
    centre = np.empty(3, np.float64)
    centre[0], centre[1], centre[2] = x_sum / count, y_sum / count, z_sum / count
    xx = xy = xz = yy = yz = zz = 0.0
    for j in range(count):
        x, y, z = points[0, near[j]] - centre[0], points[1, near[j]] - centre[1], points[2, near[j]] - centre[2]
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
    scatter = np.empty((3, 3), np.float64)
    scatter[0, 0], scatter[1, 1], scatter[2, 2] = xx / count, yy / count, zz / count
    scatter[0, 1] = scatter[1, 0] = xy / count
    scatter[0, 2] = scatter[2, 0] = xz / count
    scatter[1, 2] = scatter[2, 1] = yz / count
    return centre, scatter
