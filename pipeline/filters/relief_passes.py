"""What the relief of the ground does with all points and cells, and which points belong to it: one compiled pass each.

See `pipeline.core.compiled`. Grids are (rows along y, columns along x).
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["lowest_of_cells", "on_plane", "on_relief", "pulled", "smoothed"]

POINTS = "Array(float32, 2, 'C', True)"
"""What compiled functions take: (N, 3), perhaps read-only."""

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
    "Tuple((float64[:, ::1], float64[:, ::1]))(float64[:, ::1], float64[::1], float64[:, ::1], "
    "float64, float64, float64)"
)
def pulled(
    xy: F64, height_m: F64, surface_m: F64, near_m: float, above_m: float, above_weight: float
) -> tuple[F64, F64]:
    """How much cells pull at a surface, and their mean height above it.

    Args:
        xy: (M, 2) middles of the cells, in nodes of the surface.
        height_m: (M,) their heights.
        surface_m: (H, W) height of the surface at its nodes; each cell pulls at the nearest one.
        near_m: Cells farther from the surface do not pull.
        above_m: Cells higher above it ...
        above_weight: ... pull by this much.

    Returns:
        (H, W) sum of the weights, and (H, W) mean.
    """
    rows, columns = surface_m.shape
    total, mean = np.zeros((rows, columns), np.float64), np.zeros((rows, columns), np.float64)
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
    return total, mean


@inlined
def _symmetric(sums: F64, values: F64, stride: int, taps: F64) -> None:
    """Writes sums of values, weighted by taps: sum i is about value i + stride x (taps to one side)."""
    reach = len(taps) - 1
    middle = values[reach * stride : reach * stride + len(sums)]
    for i in range(len(sums)):
        sums[i] = middle[i] * taps[0]
    for step in range(reach, 0, -1):
        before = values[(reach - step) * stride : (reach - step) * stride + len(sums)]
        after = values[(reach + step) * stride : (reach + step) * stride + len(sums)]
        tap = taps[step]
        for i in range(len(sums)):
            sums[i] += (before[i] + after[i]) * tap


@compiled("float64[:, ::1](float64[:, ::1], float64[::1])")
def smoothed(values: F64, taps: F64) -> F64:
    """A grid (H, W), 0 beyond its edges, smoothed along both axes.

    Args:
        values: (H, W).
        taps: (R + 1,) weight of a node itself, of those beside it, and so on.
    """
    height, width = values.shape
    reach = len(taps) - 1
    padded = np.zeros((height + 2 * reach) * width, np.float64)
    for row in range(height):
        for column in range(width):
            padded[(row + reach) * width + column] = values[row, column]
    line, smooth = np.zeros(width + 2 * reach, np.float64), np.empty((height, width), np.float64)
    for row in range(height):
        _symmetric(line[reach : reach + width], padded[row * width :], width, taps)
        _symmetric(smooth[row], line, 1, taps)
    return smooth


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
