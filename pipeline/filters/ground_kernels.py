"""Passes over all points that find the ground and the points on it; compiled.

The passes of `lidcam.pipeline.filters.ground`, where they are explained; sums run in the order of the points.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, Bools
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.core.geometry.bilinear import between
from lidcam.pipeline.filters.ground import GroundPasses

MAX_CELL = 2.0**30
"""As in `ground`."""

POINTS = "Array(float32, 2, 'C', True)"
"""Type of points (3, N), perhaps read-only."""

LIST, TABLE = "Array(float64, 1, 'C', True)", "Array(float64, 2, 'C', True)"
"""Likewise: (2,), and (H, W)."""

SPREAD = np.uint64(0x9E3779B97F4A7C15)
"""Numbers times this differ in their upper bits (D. E. Knuth: The art of computer programming, vol. 3, 6.4)."""


def lowest_of_cells(points: F32, cell_m: np.float32) -> I64:
    """(M,) row of the lowest point of each occupied cell, ordered by cell."""
    cells, rows = _lowest(points, cell_m)
    return rows[np.argsort(cells)]


@inlined
def _cell(place: np.float32, cell_m: np.float32) -> np.int64:
    return np.int64(min(max(np.floor(place / cell_m), -MAX_CELL), MAX_CELL))


@compiled(f"Tuple((int64[::1], int64[::1]))({POINTS}, float32)")
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


@compiled(f"Tuple((int64[::1], int64[::1]))({POINTS}, float32[:, ::1], float32)")
def count_layers(points: F32, planes: F32, layer_m: np.float32) -> tuple[I64, I64]:
    """(K,) number of points in each plane's layer, and in the fuller of those beside it."""
    held, beside = np.empty(len(planes), np.int64), np.empty(len(planes), np.int64)
    thrice_m = np.float32(3) * layer_m
    for k in range(len(planes)):
        plane = planes[k]
        deep = low = high = top = np.int32(0)  # 32 bits: twice as many points at once
        for i in range(points.shape[1]):
            height = _height(points, i, plane)
            deep = np.int32(deep + (height <= -thrice_m))
            low = np.int32(low + (height <= -layer_m))
            high = np.int32(high + (height <= layer_m))
            top = np.int32(top + (height <= thrice_m))
        held[k] = high - low
        beside[k] = max(low - deep, top - high)
    return held, beside


@compiled(f"Tuple((float32[::1], int32[::1]))({POINTS}, float32[::1], float32)")
def _within(points: F32, plane: F32, limit_m: np.float32) -> tuple[F32, I32]:
    """(M,) distances from a plane, of the points that are at most `limit_m` from it, and (M,) which ones these are."""
    heights, rows = np.empty(points.shape[1], np.float32), np.empty(points.shape[1], np.int32)
    count = 0
    for i in range(points.shape[1]):
        height = abs(_height(points, i, plane))
        heights[count], rows[count] = height, i  # written over by the next one if it is too far
        count += 1 if height <= limit_m else 0
    return heights[:count], rows[:count]


@compiled(f"Tuple((float64[::1], float64[:, ::1]))({POINTS}, int32[::1])")
def _scatter(points: F32, rows: I32) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of some points; zeros of none."""
    centre, scatter = np.zeros(3, np.float64), np.zeros((3, 3), np.float64)
    count = len(rows)
    if count == 0:
        return centre, scatter
    x_sum = y_sum = z_sum = 0.0
    for j in range(count):
        i = np.uint32(rows[j])
        x_sum += points[0, i]
        y_sum += points[1, i]
        z_sum += points[2, i]
    centre[0], centre[1], centre[2] = x_sum / count, y_sum / count, z_sum / count
    xx = xy = xz = yy = yz = zz = 0.0
    for j in range(count):
        i = np.uint32(rows[j])
        x, y, z = points[0, i] - centre[0], points[1, i] - centre[1], points[2, i] - centre[2]
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
    scatter[0, 0], scatter[1, 1], scatter[2, 2] = xx / count, yy / count, zz / count
    scatter[0, 1] = scatter[1, 0] = xy / count
    scatter[0, 2] = scatter[2, 0] = xz / count
    scatter[1, 2] = scatter[2, 1] = yz / count
    return centre, scatter


@compiled(f"Tuple((float64[::1], float64[:, ::1]))({POINTS}, float32[::1], float32)")
def scatter_within(points: F32, plane: F32, limit_m: np.float32) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of the points at most `limit_m` from a plane."""
    return _scatter(points, _within(points, plane, limit_m)[1])


def scatter_near(points: F32, plane: F32, layer_m: np.float32) -> tuple[int, F64, F64]:
    """How many points are in the layer of a plane; centre (3,) and covariance (3, 3) of those near it."""
    heights, rows = _within(points, plane, layer_m)
    if len(heights):
        middle = len(heights) // 2
        first = middle if len(heights) % 2 else middle - 1
        lower, upper = np.partition(heights, [first, middle])[[first, middle]]  # quicker than np.median
        near_m = min(layer_m, np.float32(3 * 1.4826 * float((lower + upper) / 2) + 1e-6))
        rows = rows[heights <= near_m]
    return len(heights), *_scatter(points, rows)


COMPILED = GroundPasses(lowest_of_cells, count_layers, scatter_within, scatter_near)
"""The passes of `ground.PLAIN`."""


@compiled(
    f"Tuple((int64[::1], int64[::1], int64[::1]))"
    f"({POINTS}, boolean[::1], float32[::1], float64, {LIST}, float64, {TABLE})"
)
def parted(
    xyz: F32, kept: Bools, plane: F32, distance_m: float, origin_xy: F64, cell_m: float, offsets_m: F64
) -> tuple[I64, I64, I64]:
    """Rows of the points that are kept and not on a plane, that are kept and on it, and that are not on the ground.

    Args:
        xyz: (N, 3) metres.
        kept: (N,) which points count for the first two.
        plane: (4,) unit normal and offset.
        distance_m: On the plane or on the ground is what is at most this far from it.
        origin_xy: See `Relief`, as for the next two, which say how the ground differs from the plane.
        cell_m: Likewise.
        offsets_m: Likewise; without nodes, the ground is the plane.
    """
    left, level, above = np.empty(len(xyz), np.int64), np.empty(len(xyz), np.int64), np.empty(len(xyz), np.int64)
    left_count = level_count = above_count = 0
    lowest = highest = 0.0
    for row in range(offsets_m.shape[0]):
        for column in range(offsets_m.shape[1]):
            lowest, highest = min(lowest, offsets_m[row, column]), max(highest, offsets_m[row, column])
    # Points beyond it are not on the ground anywhere; a bit more, to allow for rounding below.
    reach_m = distance_m + 1e-9 * (distance_m - lowest + highest)
    below_m, above_m, plane_reach_m = lowest - reach_m, highest + reach_m, np.float32(distance_m)
    for i in range(len(xyz)):
        height = xyz[i, 0] * plane[0] + xyz[i, 1] * plane[1] + xyz[i, 2] * plane[2] + plane[3]
        on_plane = on_ground = abs(height) <= plane_reach_m
        if offsets_m.size > 0:
            on_ground = False
            if below_m <= height <= above_m:
                x, y = (xyz[i, 0] - origin_xy[0]) / cell_m, (xyz[i, 1] - origin_xy[1]) / cell_m
                on_ground = abs(height - between(offsets_m, x, y)) <= distance_m
        # Written over by the next one that belongs there.
        left[left_count] = level[level_count] = above[above_count] = i
        left_count += 1 if kept[i] and not on_plane else 0
        level_count += 1 if kept[i] and on_plane else 0
        above_count += 0 if on_ground else 1
    return left[:left_count], level[:level_count], above[:above_count]
