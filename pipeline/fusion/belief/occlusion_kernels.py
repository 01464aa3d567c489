"""The passes of `occlusion`, compiled: how far each cell of a camera sees, and what that hides of each object."""

import math

import numpy as np

from pipeline.core.arrays import F32, F64, Indices
from pipeline.core.compiled import compiled

__all__ = ["nearer_shares", "nearest_in_cells"]

_ROWS = "Array(int64, 1, 'C', True)"
_TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (2, 3))
_TABLE32, _BLOCK32 = (f"Array(float32, {dimensions}, 'C', True)" for dimensions in (2, 3))
_POINTS = "Array(float32, 2, 'A', True)"


@compiled(f"float32[:, :, ::1]({_BLOCK32}, {_POINTS}, {_TABLE32}, {_TABLE32}, int64, int64, float32)")
def nearest_in_cells(matrices: F32, xyz: F32, low: F32, cell: F32, columns: int, rows: int, near_m: float) -> F32:
    """Range of the nearest point in each cell of each camera's field of view.

    Args:
        matrices: (C, 4, 4) site to camera.
        xyz: (P, 3) points in the site frame, metres.
        low: (C, 2) low ends of the fields of view across and down, in the plane one metre ahead.
        cell: (C, 2) sizes of a cell there.
        columns: Cells across.
        rows: Cells down.
        near_m: Points that are not so far ahead are left out.

    Returns:
        (C, rows, columns) metres; inf without a point.
    """
    nearest = np.full((len(matrices), rows, columns), np.float32(np.inf), np.float32)
    for c in range(len(matrices)):
        T = matrices[c]
        for p in range(len(xyz)):
            x = T[0, 0] * xyz[p, 0] + T[0, 1] * xyz[p, 1] + T[0, 2] * xyz[p, 2] + T[0, 3]
            y = T[1, 0] * xyz[p, 0] + T[1, 1] * xyz[p, 1] + T[1, 2] * xyz[p, 2] + T[1, 3]
            z = T[2, 0] * xyz[p, 0] + T[2, 1] * xyz[p, 1] + T[2, 2] * xyz[p, 2] + T[2, 3]
            if z > near_m:
                column, row = (x / z - low[c, 0]) / cell[c, 0], (y / z - low[c, 1]) / cell[c, 1]
                if column >= 0 and column < columns and row >= 0 and row < rows:
                    own = nearest[c, np.int64(row)]
                    own[np.int64(column)] = min(own[np.int64(column)], np.sqrt(x * x + y * y + z * z))
    return nearest


@compiled(
    f"float64[::1]({_BLOCK32}, {_BLOCK}, {_BLOCK}, {_ROWS}, {_ROWS}, {_TABLE}, {_TABLE}, float64, float64, float64)"
)
def nearer_shares(
    nearest: F32,
    matrices: F64,
    corners: F64,
    cameras: Indices,
    objects: Indices,
    low: F64,
    cell: F64,
    near_m: float,
    nearer: float,
    open_cells: float,
) -> F64:
    """Share of the cells that an object fills whose nearest point is in front of it, of Q pairs of camera and object.

    Args:
        nearest: (C, rows, columns) of `nearest_in_cells`.
        matrices: (C, 4, 4) site to camera.
        corners: (N, 8, 3) corners of the objects' boxes in the site frame, metres.
        cameras: (Q,) camera of each pair.
        objects: (Q,) object of each pair.
        low: (C, 2) low ends of the fields of view across and down, in the plane one metre ahead.
        cell: (C, 2) sizes of a cell there.
        near_m: Corners count as no nearer than this.
        nearer: A point is in front if it is nearer than this share of the range of the object's near side.
        open_cells: Cells that are taken to be free beside those that have a point.

    Returns:
        (Q,) in [0, 1).
    """
    shares, counts = np.empty(len(cameras)), np.array([nearest.shape[2], nearest.shape[1]])
    seen, ends, middle = np.empty((8, 3)), np.empty((2, 2)), np.empty(3)
    for q in range(len(cameras)):
        c, n = cameras[q], objects[q]
        T = matrices[c]
        middle[:] = 0.0
        for k in range(8):
            for i in range(3):
                seen[k, i] = (
                    T[i, 0] * corners[n, k, 0] + T[i, 1] * corners[n, k, 1] + T[i, 2] * corners[n, k, 2] + T[i, 3]
                )
                middle[i] += seen[k, i] / 8
        reach = 0.0
        for k in range(8):
            x, y, z = seen[k, 0] - middle[0], seen[k, 1] - middle[1], seen[k, 2] - middle[2]
            reach = max(reach, math.sqrt(x * x + y * y + z * z))
        near_side_m = math.sqrt(middle[0] ** 2 + middle[1] ** 2 + middle[2] ** 2) - reach
        for axis in range(2):  # the first cell across, or down, and the one behind the last
            first, last = np.inf, -np.inf
            for k in range(8):
                place = (seen[k, axis] / max(seen[k, 2], near_m) - low[c, axis]) / cell[c, axis]
                first, last = min(first, place), max(last, place)
            ends[axis, 0] = min(max(math.floor(first), -1.0), counts[axis])
            ends[axis, 1] = max(min(max(math.ceil(last), 0.0), counts[axis] + 1), ends[axis, 0] + 1)
        in_front, measured = 0, 0
        for row in range(int(max(ends[1, 0], 0.0)), int(min(ends[1, 1], counts[1]))):
            for column in range(int(max(ends[0, 0], 0.0)), int(min(ends[0, 1], counts[0]))):
                range_m = nearest[c, row, column]
                measured += np.isfinite(range_m)
                in_front += range_m < nearer * near_side_m
        shares[q] = in_front / (measured + open_cells)
    return shares
