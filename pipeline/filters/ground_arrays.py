"""What finding the ground does with all points, by numpy: where nothing shall be compiled, as in `lidcam inspect`."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64

__all__ = ["count_layers", "heights_within", "lowest_of_cells", "scatter_within"]

MAX_CELL = 1 << 30
"""Cells farther from the origin are taken for the last one."""


def lowest_of_cells(points: F32, cell_m: np.float32) -> I64:
    """(M,) row of the lowest point of each occupied cell of a square grid over x and y, ordered by cell.

    Args:
        points: (3, N) metres, finite; of equally low ones the first is taken.
        cell_m: Edge of the cells.
    """
    cells = np.clip(np.floor(points[:2] / cell_m), -MAX_CELL, MAX_CELL).astype(np.int64)
    cell = cells[0] * (2 * MAX_CELL + 1) + cells[1]
    order = np.lexsort((points[2], cell))
    first = np.ones(len(cell), np.bool_)
    first[1:] = np.diff(cell[order]) != 0
    return order[first]


def count_layers(points: F32, planes: F32, layer_m: np.float32) -> tuple[I64, I64]:
    """(K,) number of points within a layer of each plane, and in the fuller of the equal layers above and below.

    Args:
        points: (3, N) metres, finite.
        planes: (K, 4) unit normal and offset.
        layer_m: What is at most this far from a plane, on either side, is in its layer.
    """
    heights = _heights(points, planes)
    edges = (-3 * layer_m, -layer_m, layer_m, 3 * layer_m)
    below, held, above = np.diff([np.count_nonzero(heights <= edge, axis=1) for edge in edges], axis=0)
    return held, np.maximum(below, above)


def heights_within(points: F32, plane: F32, limit_m: np.float32) -> F32:
    """(M,) distances of points (3, N) from a plane (4,), of those that are at most `limit_m`."""
    heights = np.abs(_heights(points, plane[None])[0])
    within: F32 = heights[heights <= limit_m]
    return within


def scatter_within(points: F32, plane: F32, limit_m: np.float32) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of the points (3, N) at most `limit_m` from a plane (4,); there are some."""
    near = points[:, np.abs(_heights(points, plane[None])[0]) <= limit_m]
    centre = near.mean(axis=1, dtype=np.float64)
    centred = near - centre[:, None]
    return centre, np.einsum("in,jn->ij", centred, centred) / near.shape[1]  # not BLAS, see _heights


def _heights(points: F32, planes: F32) -> F32:
    """(K, N) signed distances of points (3, N) from planes (K, 4)."""
    # Not BLAS, whose rounding may depend on the number of threads.
    a, b, c, d = planes.T[..., None]
    heights: F32 = points[0] * a + points[1] * b
    heights += points[2] * c
    heights += d
    return heights
