"""Points in the footprints of boxes, seen from above."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["points_in_footprints"]

RUN = 16
"""So many points that follow each other are looked at together: neighbours in a scan are neighbours in space."""

ROOM = 1.0 + 1e-9
"""Runs are left out that are so much further away than a rectangle reaches, which is more than any rounding takes."""


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
    count, rows, rectangle = _points_in_rectangles(
        np.ascontiguousarray(xyz), np.ascontiguousarray(centers_xy), half, np.cos(yaws), np.sin(yaws)
    )
    return rows[:count], rectangle[:count]


@inlined
def _bounds(xyz: F32) -> F64:
    """(R, 4) least x and y and largest x and y of the points of each run."""
    bounds = np.empty(((len(xyz) + RUN - 1) // RUN, 4))
    for run in range(len(bounds)):
        first = run * RUN
        x, y = xyz[first, 0], xyz[first, 1]
        top_x, top_y = x, y
        for i in range(first + 1, min(first + RUN, len(xyz))):
            x, top_x = min(x, xyz[i, 0]), max(top_x, xyz[i, 0])
            y, top_y = min(y, xyz[i, 1]), max(top_y, xyz[i, 1])
        bounds[run, 0], bounds[run, 1], bounds[run, 2], bounds[run, 3] = x, y, top_x, top_y
    return bounds


@compiled(
    "Tuple((int64, int64[::1], int64[::1]))"
    "(Array(float32, 2, 'C', readonly=True), Array(float64, 2, 'C', readonly=True), float64[:, ::1], "
    "float64[::1], float64[::1])"
)
def _points_in_rectangles(xyz: F32, centers_xy: F64, half: F64, cos: F64, sin: F64) -> tuple[int, I64, I64]:
    """The number of pairs of a point and a rectangle that holds it, and room for them: see `points_in_footprints`.

    Args:
        xyz: (N, 3) metres.
        centers_xy: (B, 2) metres.
        half: (B, 2) of the length and the width, metres.
        cos: (B,) of the yaws.
        sin: (B,) of the yaws.
    """
    rows, rectangle = np.empty(64, np.int64), np.empty(64, np.int64)
    found, bounds = 0, _bounds(xyz)
    for b in range(len(cos)):
        center_x, center_y = centers_xy[b, 0], centers_xy[b, 1]
        reach = abs(cos[b]) * half[b, 0] + abs(sin[b]) * half[b, 1]
        low, high = center_x - reach, center_x + reach
        reach_y = (abs(sin[b]) * half[b, 0] + abs(cos[b]) * half[b, 1] + abs(center_y)) * ROOM - abs(center_y)
        for run in range(len(bounds)):
            if bounds[run, 0] > high or bounds[run, 2] < low:
                continue
            if bounds[run, 1] - center_y > reach_y or center_y - bounds[run, 3] > reach_y:
                continue
            for i in range(run * RUN, min(run * RUN + RUN, len(xyz))):
                if not low <= xyz[i, 0] <= high:
                    continue
                x, y = xyz[i, 0] - center_x, xyz[i, 1] - center_y
                if abs(x * cos[b] + y * sin[b]) <= half[b, 0] and abs(y * cos[b] - x * sin[b]) <= half[b, 1]:
                    if found == len(rows):
                        more_rows, more = np.empty(2 * found, np.int64), np.empty(2 * found, np.int64)
                        for k in range(found):
                            more_rows[k], more[k] = rows[k], rectangle[k]
                        rows, rectangle = more_rows, more
                    rows[found], rectangle[found] = i, b
                    found += 1
    return found, rows, rectangle
