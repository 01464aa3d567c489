"""The loop of `footprints.py` over all points for each rectangle: most are left out by two comparisons."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled

__all__ = ["points_in_rectangles"]


@compiled(
    "Tuple((int64, int64[::1], int64[::1]))"
    "(Array(float32, 2, 'C', readonly=True), Array(float64, 2, 'C', readonly=True), float64[:, ::1], "
    "float64[::1], float64[::1])"
)
def points_in_rectangles(xyz: F32, centers_xy: F64, half: F64, cos: F64, sin: F64) -> tuple[int, I64, I64]:
    """The number of pairs of a point and a rectangle that holds it, and room for them: see `points_in_footprints`.

    Args:
        xyz: (N, 3) metres.
        centers_xy: (B, 2) metres.
        half: (B, 2) of the length and the width, metres.
        cos: (B,) of the yaws.
        sin: (B,) of the yaws.
    """
    rows, rectangle = np.empty(64, np.int64), np.empty(64, np.int64)
    found = 0
    for b in range(len(cos)):
        reach = abs(cos[b]) * half[b, 0] + abs(sin[b]) * half[b, 1]
        low, high = centers_xy[b, 0] - reach, centers_xy[b, 0] + reach
        for i in range(len(xyz)):
            if not low <= xyz[i, 0] <= high:
                continue
            x, y = xyz[i, 0] - centers_xy[b, 0], xyz[i, 1] - centers_xy[b, 1]
            if abs(x * cos[b] + y * sin[b]) <= half[b, 0] and abs(y * cos[b] - x * sin[b]) <= half[b, 1]:
                if found == len(rows):
                    more_rows, more = np.empty(2 * found, np.int64), np.empty(2 * found, np.int64)
                    for k in range(found):
                        more_rows[k], more[k] = rows[k], rectangle[k]
                    rows, rectangle = more_rows, more
                rows[found], rectangle[found] = i, b
                found += 1
    return found, rows, rectangle
