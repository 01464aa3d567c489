"""What the relief of the ground does with all points and cells, and which points belong to it: one compiled pass each.

See `pipeline.core.compiled`. Grids are (rows along y, columns along x).
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["grown", "lowest_of_cells", "on_plane", "on_relief", "pull", "smoothed"]

POINTS = "Array(float32, 2, 'C', True)"
"""What compiled functions take: (N, 3), perhaps read-only."""

ROWS_AT_ONCE = 8
"""Rows of a grid that are smoothed together: enough for long loops, few enough to stay near the processor."""

ORIGIN, GRID = "Array(float64, 1, 'C', True)", "Array(float64, 2, 'C', True)"
"""Likewise: (2,), and (H, W)."""


@compiled(
    f"Tuple((int64[::1], float64[::1]))({POINTS}, float32[::1], float32[::1], float32[::1], "
    "float32, int64, float32, float32, float32)"
)
def lowest_of_cells(
    xyz: F32,
    plane: F32,
    middle: F32,
    origin: F32,
    cell_m: np.float32,
    side: int,
    reach_m: np.float32,
    slope: np.float32,
    layer_m: np.float32,
) -> tuple[I64, F64]:
    """The cells of a grid that hold points near a plane, and the mean height of the lowest of them above it.

    Args:
        xyz: (N, 3) metres, finite.
        plane: (4,) normal and offset.
        middle: (2,) from where distances count.
        origin: (2,) lowest corner of the grid.
        cell_m: Edge of its cells.
        side: Cells along each edge of the grid.
        reach_m: Points are near if they are at most this, ...
        slope: ... and this multiple of their distance from the middle, above or below the plane.
        layer_m: Points are low if they are at most this much higher than the lowest of the cell.

    Returns:
        (M,) cells, row x side + column, ascending, and (M,) metres.
    """
    count = len(xyz)
    cells, heights = np.empty(count, np.int32), np.empty(count, np.float32)
    lowest = np.full(side * side, np.float32(np.inf))
    kept = 0
    for i in range(count):
        x, y = xyz[i, 0], xyz[i, 1]
        height = (x * plane[0] + y * plane[1] + xyz[i, 2] * plane[2] + plane[3]) / plane[2]
        dx, dy = x - middle[0], y - middle[1]
        column, row = np.floor((x - origin[0]) / cell_m), np.floor((y - origin[1]) / cell_m)
        if abs(height) <= reach_m + slope * np.sqrt(dx * dx + dy * dy) and 0 <= column < side and 0 <= row < side:
            cell = int(row) * side + int(column)
            lowest[cell] = min(lowest[cell], height)
            cells[kept], heights[kept] = cell, height
            kept += 1

    counts, sums = np.zeros(side * side, np.int64), np.zeros(side * side, np.float64)
    held = 0
    for j in range(kept):
        if heights[j] <= lowest[cells[j]] + layer_m:
            held += 1 if counts[cells[j]] == 0 else 0
            counts[cells[j]] += 1
            sums[cells[j]] += heights[j]
    found, means = np.empty(held, np.int64), np.empty(held, np.float64)
    held = 0
    for cell in range(side * side):
        if counts[cell] > 0:
            found[held], means[held] = cell, sums[cell] / counts[cell]
            held += 1
    return found, means


@inlined
def _between(values: F64, x: float, y: float) -> float:
    """Bilinear at x, y in cells; beyond the grid that of its edge."""
    height, width = values.shape
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    x, y = x - column, y - row
    near = values[row, column] * (1 - x) + values[row, column + 1] * x
    far = values[row + 1, column] * (1 - x) + values[row + 1, column + 1] * x
    return float(near * (1 - y) + far * y)


@compiled(
    "void(float64[:, ::1], float64[::1], float64[:, ::1], float64, float64, float64, float64[:, ::1], float64[:, ::1])"
)
def pull(
    xy: F64, height_m: F64, surface_m: F64, near_m: float, above_m: float, above_weight: float, total: F64, mean: F64
) -> None:
    """How much cells pull at a surface, and their mean height above it.

    Args:
        xy: (M, 2) middles of the cells, in nodes of the surface.
        height_m: (M,) their heights.
        surface_m: (H, W) height of the surface at its nodes; each cell pulls at the nearest one.
        near_m: Cells farther from the surface do not pull.
        above_m: Cells higher above it ...
        above_weight: ... pull by this much.
        total: (H, W) where the sum of the weights is written to.
        mean: (H, W) and the mean.
    """
    rows, columns = surface_m.shape
    for row in range(rows):
        for column in range(columns):
            total[row, column] = mean[row, column] = 0.0
    for i in range(len(xy)):
        above = height_m[i] - _between(surface_m, xy[i, 0], xy[i, 1])
        if abs(above) <= near_m:
            weight = above_weight if above > above_m else 1.0
            column, row = int(np.rint(xy[i, 0])), int(np.rint(xy[i, 1]))
            total[row, column] += weight
            mean[row, column] += weight * above
    for row in range(rows):
        for column in range(columns):
            mean[row, column] /= max(total[row, column], 1e-9)


@inlined
def _symmetric(sums: F64, values: F64, stride: int, taps: F64) -> None:
    """Writes sums of values, weighted by taps: sum i is about value i + stride x (taps to one side)."""
    reach, count = len(taps) - 1, len(sums)
    middle = values[reach * stride :]
    for i in range(count):
        sums[i] = middle[i] * taps[0]
    step = reach
    while step >= 5:  # five taps at once: each sum is read and written once for all of them
        first, last = (reach - step) * stride, (reach + step) * stride
        a, b, c = values[first:], values[first + stride :], values[first + 2 * stride :]
        d, e = values[first + 3 * stride :], values[first + 4 * stride :]
        f, g, h = values[last:], values[last - stride :], values[last - 2 * stride :]
        j, k = values[last - 3 * stride :], values[last - 4 * stride :]
        af, bg, ch, dj, ek = taps[step], taps[step - 1], taps[step - 2], taps[step - 3], taps[step - 4]
        for i in range(count):
            total = sums[i] + (a[i] + f[i]) * af
            total += (b[i] + g[i]) * bg
            total += (c[i] + h[i]) * ch
            total += (d[i] + j[i]) * dj
            sums[i] = total + (e[i] + k[i]) * ek
        step -= 5
    while step > 0:
        before, after, tap = values[(reach - step) * stride :], values[(reach + step) * stride :], taps[step]
        for i in range(count):
            sums[i] += (before[i] + after[i]) * tap
        step -= 1


@compiled("void(float64[:, ::1], float64[::1], float64[::1], float64[:, ::1])")
def _smooth(values: F64, taps: F64, room: F64, smooth: F64) -> None:
    """Writes a grid (H, W), smoothed along both axes, to `smooth`; see `smoothed`, and `_room` for what it needs."""
    height, width = values.shape
    reach = len(taps) - 1
    line = width + 2 * reach  # rows lie one after another, with zeros between them
    held = ROWS_AT_ONCE * line + 2 * reach
    padded, sums, along = room[2 * held :], room[:held], room[held : 2 * held]
    for i in range(held):
        sums[i] = 0.0
    for i in range((height + 2 * reach) * line):
        padded[i] = 0.0
    for row in range(height):
        for column in range(width):
            padded[(row + reach) * line + reach + column] = values[row, column]
    for first in range(0, height, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, height - first)
        _symmetric(sums[reach : reach + rows * line], padded[first * line :], line, taps)
        _symmetric(along[: rows * line], sums, 1, taps)
        for row in range(rows):
            for column in range(width):
                smooth[first + row, column] = along[row * line + reach + column]


@inlined
def _room(height: int, width: int, reach: int) -> F64:
    """What `_smooth` needs for a grid (H, W) and so many taps to a side, or fewer."""
    line = width + 2 * reach
    return np.empty((height + 2 * reach + 2 * ROWS_AT_ONCE) * line + 4 * reach, np.float64)


@compiled("float64[:, ::1](float64[:, ::1], float64[::1])")
def smoothed(values: F64, taps: F64) -> F64:
    """A grid (H, W), 0 beyond its edges, smoothed along both axes.

    Args:
        values: (H, W).
        taps: (R + 1,) weight of a node itself, of those beside it, and so on.
    """
    height, width = values.shape
    smooth = np.empty((height, width), np.float64)
    _smooth(values, taps, _room(height, width, len(taps) - 1), smooth)
    return smooth


@compiled(
    "Tuple((float64[:, ::1], float64[:, ::1]))"
    "(float64[:, ::1], float64[::1], int64, float64[::1], int64[::1], float64[::1], float64[::1])"
)
def grown(xy: F64, height_m: F64, side: int, taps: F64, counts: I64, near_m: F64, limits: F64) -> tuple[F64, F64]:
    """A surface that grows from zero towards cells, and how much these pull at its nodes in the last round.

    Args:
        xy: (M, 2) middles of the cells, in nodes of the surface.
        height_m: (M,) their heights.
        side: The surface has so many nodes along each edge.
        taps: Of the smoothing in each round, one round after another; see `smoothed`.
        counts: (R,) number of taps of each round.
        near_m: (R,) cells farther from the surface do not pull.
        limits: (4,) cells higher above the surface than the first pull by the second; the most that a node is pulled
            by; and the weight of the last surface.

    Returns:
        (side, side) heights, and (side, side) weights.
    """
    shape, reach = (side, side), counts.max() - 1
    surface, weight, mean = np.zeros(shape, np.float64), np.zeros(shape, np.float64), np.empty(shape, np.float64)
    rise, trust, room, first = np.empty(shape, np.float64), np.empty(shape, np.float64), _room(side, side, reach), 0
    for k in range(len(counts)):
        pull(xy, height_m, surface, near_m[k], limits[0], limits[1], weight, mean)
        for row in range(side):
            for column in range(side):
                weight[row, column] = min(weight[row, column], limits[2])
                mean[row, column] *= weight[row, column]
        own = taps[first : first + counts[k]]
        first += counts[k]
        _smooth(mean, own, room, rise)
        _smooth(weight, own, room, trust)
        for row in range(side):
            for column in range(side):
                surface[row, column] += rise[row, column] / (trust[row, column] + limits[3])
    return surface, weight


@inlined
def _height(xyz: F32, i: int, plane: F32) -> np.float32:
    height: np.float32 = xyz[i, 0] * plane[0] + xyz[i, 1] * plane[1] + xyz[i, 2] * plane[2] + plane[3]
    return height


@compiled(f"boolean[::1]({POINTS}, float32[::1], float32)")
def on_plane(xyz: F32, plane: F32, distance_m: np.float32) -> Bools:
    """(N,) whether points (N, 3) are at most `distance_m` from a plane (4,), unit normal and offset."""
    on = np.empty(len(xyz), np.bool_)
    for i in range(len(xyz)):
        on[i] = abs(_height(xyz, i, plane)) <= distance_m
    return on


@compiled(f"boolean[::1]({POINTS}, float32[::1], {ORIGIN}, float64, {GRID}, float64)")
def on_relief(xyz: F32, plane: F32, origin_xy: F64, cell_m: float, offsets_m: F64, distance_m: float) -> Bools:
    """(N,) whether points (N, 3) are at most `distance_m` from the ground, which differs from a plane (4,).

    The others are those of `Relief`.
    """
    on = np.empty(len(xyz), np.bool_)
    for i in range(len(xyz)):
        x, y = (xyz[i, 0] - origin_xy[0]) / cell_m, (xyz[i, 1] - origin_xy[1]) / cell_m
        on[i] = abs(_height(xyz, i, plane) - _between(offsets_m, x, y)) <= distance_m
    return on
