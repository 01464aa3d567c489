"""What the relief of the ground does with all points and cells, and which points belong to it: one compiled pass each.

See `pipeline.core.compiled`. Grids are (rows along y, columns along x).
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["lowest_of_cells", "parted"]

POINTS = "Array(float32, 2, 'C', True)"
"""What compiled functions take: points in rows or columns, perhaps read-only."""

ORIGIN, GRID = "Array(float64, 1, 'C', True)", "Array(float64, 2, 'C', True)"
"""Likewise: (2,), and (H, W)."""


@compiled(
    f"Tuple((int64[::1], float64[::1]))({POINTS}, float32[::1], float32[::1], float32[::1], "
    "float32, int64, float32, float32, float32)"
)
def lowest_of_cells(
    points: F32,
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
        points: (3, N) metres, finite.
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
    count = points.shape[1]
    cells, heights = np.empty(count, np.int32), np.empty(count, np.float32)
    kept, first, last = 0, side * side, -1
    for i in range(count):
        x, y = points[0, i], points[1, i]
        height = (x * plane[0] + y * plane[1] + points[2, i] * plane[2] + plane[3]) / plane[2]
        if abs(height) > reach_m:
            dx, dy = x - middle[0], y - middle[1]
            if not abs(height) <= reach_m + slope * np.sqrt(dx * dx + dy * dy):
                continue
        column, row = np.floor((x - origin[0]) / cell_m), np.floor((y - origin[1]) / cell_m)
        if 0 <= column < side and 0 <= row < side:
            cell = int(row) * side + int(column)
            first, last = min(first, cell), max(last, cell)
            cells[kept], heights[kept] = cell, height
            kept += 1

    size = max(last - first + 1, 0)  # of the part of the grid that holds points
    lowest, counts, sums = np.full(size, np.float32(np.inf)), np.zeros(size, np.int32), np.zeros(size, np.float64)
    for j in range(kept):
        at = np.uint32(cells[j] - first)
        lowest[at] = min(lowest[at], heights[j])
    held = 0
    for j in range(kept):
        at = np.uint32(cells[j] - first)
        if heights[j] <= lowest[at] + layer_m:
            held += 1 if counts[at] == 0 else 0
            counts[at] += np.int32(1)
            sums[at] += heights[j]
    found, means = np.empty(held, np.int64), np.empty(held, np.float64)
    held = 0
    for j in range(size):
        if counts[j] > 0:
            found[held], means[held] = first + j, sums[j] / counts[j]
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
    f"Tuple((int64[::1], int64[::1], int64[::1]))"
    f"({POINTS}, boolean[::1], float32[::1], float64, {ORIGIN}, float64, {GRID})"
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
    # What is beyond is not on the ground wherever it is; a bit more, for what is rounded below.
    reach_m = distance_m + 1e-9 * (distance_m - lowest + highest)
    below_m, above_m, plane_reach_m = lowest - reach_m, highest + reach_m, np.float32(distance_m)
    for i in range(len(xyz)):
        height = xyz[i, 0] * plane[0] + xyz[i, 1] * plane[1] + xyz[i, 2] * plane[2] + plane[3]
        on_plane = on_ground = abs(height) <= plane_reach_m
        if offsets_m.size > 0:
            on_ground = False
            if below_m <= height <= above_m:
                x, y = (xyz[i, 0] - origin_xy[0]) / cell_m, (xyz[i, 1] - origin_xy[1]) / cell_m
                on_ground = abs(height - _between(offsets_m, x, y)) <= distance_m
        left[left_count] = level[level_count] = above[above_count] = (
            i  # written over by the next one that belongs there
        )
        left_count += 1 if kept[i] and not on_plane else 0
        level_count += 1 if kept[i] and on_plane else 0
        above_count += 0 if on_ground else 1
    return left[:left_count], level[:level_count], above[:above_count]
