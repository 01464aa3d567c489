"""Points in the footprints of boxes, seen from above."""

import numpy as np

from pipeline.core.arrays import F64, I64

__all__ = ["points_in_footprints"]


def points_in_footprints(xy: F64, centers_xy: F64, sizes_xy: F64, yaws: F64) -> tuple[I64, I64]:
    """Which points lie in which of B rectangles; borders belong to them.

    Args:
        xy: (N, 2) metres.
        centers_xy: (B, 2) metres.
        sizes_xy: (B, 2) length and width, metres.
        yaws: (B,) of the length, about +z.

    Returns:
        (P,) rows of the points, sorted by rectangle and then by row, and (P,) the rectangle of each; a point that lies
        in several comes several times.
    """
    order = np.argsort(xy[:, 0], kind="stable")
    cos, sin = np.cos(yaws), np.sin(yaws)
    half = sizes_xy / 2
    reach_x = np.abs(cos) * half[:, 0] + np.abs(sin) * half[:, 1]
    along_x = xy[order, 0]
    first = np.searchsorted(along_x, centers_xy[:, 0] - reach_x, side="left")
    counts = np.searchsorted(along_x, centers_xy[:, 0] + reach_x, side="right") - first
    box = np.repeat(np.arange(len(yaws)), counts)
    place = np.arange(len(box)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = order[first[box] + place]
    x, y = (xy[rows] - centers_xy[box]).T
    within = np.abs(x * cos[box] + y * sin[box]) <= half[box, 0]
    within &= np.abs(y * cos[box] - x * sin[box]) <= half[box, 1]
    rows, box = rows[within], box[within]
    ordered = np.lexsort((rows, box))
    return rows[ordered].astype(np.int64), box[ordered].astype(np.int64)
