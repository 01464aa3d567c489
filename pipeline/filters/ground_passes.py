"""What finding the ground does with all points, each in one compiled pass: see `pipeline.core.compiled`.

The same as `pipeline.filters.ground_arrays`, where the functions are explained; sums run in the order of the points.
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["can_be_ground", "count_layers", "lowest_of_cells", "planes_through", "scatter_near", "scatter_within"]


MAX_CELL = 2.0**30
"""As in `ground_arrays`."""

POINTS = "Array(float32, 2, 'C', True)"
"""What compiled functions take: (3, N), perhaps read-only."""

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


@compiled(f"float64[:, ::1]({POINTS}, int64[:, ::1])")
def planes_through(points: F32, triples: I64) -> F64:
    """(up to K, 4) planes through three points each."""
    planes = np.empty((len(triples), 4), np.float64)
    found = 0
    for i, j, k in triples:
        x, y, z = np.float64(points[0, i]), np.float64(points[1, i]), np.float64(points[2, i])
        ax, ay, az = points[0, j] - x, points[1, j] - y, points[2, j] - z
        bx, by, bz = points[0, k] - x, points[1, k] - y, points[2, k] - z
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 1e-9:
            upwards = -1.0 if nz < 0 else 1.0
            nx, ny, nz = nx / length * upwards, ny / length * upwards, nz / length * upwards
            plane = planes[found]
            plane[0], plane[1], plane[2], plane[3] = nx, ny, nz, -(nx * x + ny * y + nz * z)
            found += 1
    return planes[:found]


@compiled("boolean[::1](float64[:, ::1], Array(float64, 2, 'C', True), float64[::1])")
def can_be_ground(planes: F64, lidar_origins: F64, limits: F64) -> Bools:
    """(K,) whether planes are level enough, below every lidar and at the expected height."""
    fit = np.empty(len(planes), np.bool_)
    for k in range(len(planes)):
        x, y, z, offset = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        fit[k] = z >= limits[0] and abs(offset + limits[1] * z) <= limits[2] * z
        for lidar in range(len(lidar_origins)):
            origin = lidar_origins[lidar]
            fit[k] &= x * origin[0] + y * origin[1] + z * origin[2] + offset > 0
    return fit


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


@compiled(f"Tuple((int64, float64[::1], float64[:, ::1]))({POINTS}, float32[::1], float32)")
def scatter_near(points: F32, plane: F32, layer_m: np.float32) -> tuple[int, F64, F64]:
    """How many points are in the layer of a plane; centre (3,) and covariance (3, 3) of those near it."""
    heights, rows = _within(points, plane, layer_m)
    near = 0
    if len(heights) > 0:
        near_m = min(layer_m, np.float32(3 * 1.4826 * np.median(heights) + 1e-6))
        for j in range(len(rows)):
            rows[near] = rows[j]
            near += 1 if heights[j] <= near_m else 0
    centre, scatter = _scatter(points, rows[:near])
    return len(heights), centre, scatter
