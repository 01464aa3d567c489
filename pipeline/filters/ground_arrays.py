"""What finding the ground does with all points, by numpy: where nothing shall be compiled, as in `lidcam inspect`."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools

__all__ = ["can_be_ground", "count_layers", "lowest_of_cells", "planes_through", "scatter_near", "scatter_within"]

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


def planes_through(points: F32, triples: I64) -> F64:
    """(up to K, 4) planes through three points each, unit normal, upwards, and offset.

    There is none where a point was drawn twice or all three lie on a line.

    Args:
        points: (3, N) metres.
        triples: (K, 3) columns of `points`.
    """
    a, b, c = points.T.astype(np.float64)[triples.T]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    spanned = lengths > 1e-9
    normals = normals[spanned] / lengths[spanned, None]
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    return np.column_stack([normals, -(normals * a[spanned]).sum(axis=1)])


def can_be_ground(planes: F64, lidar_origins: F64, limits: F64) -> Bools:
    """(K,) whether planes (K, 4) are level enough, below every lidar and at the expected height.

    Args:
        planes: Unit normals and offsets.
        lidar_origins: (L, 3) metres.
        limits: (3,) the least z of the normal, above 0; the height at the origin, metres; how far it may be from that.
    """
    level, height_m, tolerance_m = limits
    fit: Bools = planes[:, 2] >= level
    fit &= (np.einsum("ka,la->kl", planes[:, :3], lidar_origins) + planes[:, 3:] > 0).all(axis=1)
    # Not divided by the normal's z, which may be 0.
    fit[fit] &= np.abs(planes[fit, 3] + height_m * planes[fit, 2]) <= tolerance_m * planes[fit, 2]
    return fit


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


def scatter_within(points: F32, plane: F32, limit_m: np.float32) -> tuple[F64, F64]:
    """Centre (3,) and covariance (3, 3) of the points (3, N) at most `limit_m` from a plane (4,); there are some."""
    near = points[:, np.abs(_heights(points, plane[None])[0]) <= limit_m]
    centre = near.mean(axis=1, dtype=np.float64)
    centred = near - centre[:, None]
    return centre, np.einsum("in,jn->ij", centred, centred) / near.shape[1]  # not BLAS, see _heights


def scatter_near(points: F32, plane: F32, layer_m: np.float32) -> tuple[int, F64, F64]:
    """How many points (3, N) are in the layer of a plane (4,); centre (3,) and covariance (3, 3) of those near it.

    Near means within `layer_m`, and within three times the robust deviation of those points: wheels and kerbs lie on
    one side and would lift a plane. Without a point in the layer, both are zero.
    """
    heights = np.abs(_heights(points, plane[None])[0])
    within = heights[heights <= layer_m]
    if not len(within):
        return 0, np.zeros(3), np.zeros((3, 3))
    near_m = min(layer_m, np.float32(3 * 1.4826 * float(np.median(within)) + 1e-6))
    return len(within), *scatter_within(points, plane, near_m)


def _heights(points: F32, planes: F32) -> F32:
    """(K, N) signed distances of points (3, N) from planes (K, 4)."""
    # Not BLAS, whose rounding may depend on the number of threads.
    a, b, c, d = planes.T[..., None]
    heights: F32 = points[0] * a + points[1] * b
    heights += points[2] * c
    heights += d
    return heights
