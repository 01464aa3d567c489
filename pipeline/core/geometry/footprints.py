"""Points in the footprints of boxes, seen from above."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.geometry.footprint_kernels import points_in_rectangles

__all__ = ["points_in_footprints"]


def points_in_footprints(xyz: F32, centers_xy: F64, sizes_xy: F64, yaws: F64) -> tuple[I64, I64]:
    """Which points lie in which of B rectangles; borders belong to them.

    Args:
        xyz: (N, 3) metres, of which x and y count.
        centers_xy: (B, 2) metres.
        sizes_xy: (B, 2) length and width, metres.
        yaws: (B,) of the length, about +z.

    Returns:
        (P,) rows of the points, sorted by rectangle and then by row, and (P,) the rectangle of each; a point that lies
        in several comes several times.
    """
    half = np.ascontiguousarray(sizes_xy) / 2
    count, rows, rectangle = points_in_rectangles(
        np.ascontiguousarray(xyz), np.ascontiguousarray(centers_xy), half, np.cos(yaws), np.sin(yaws)
    )
    return rows[:count], rectangle[:count]
