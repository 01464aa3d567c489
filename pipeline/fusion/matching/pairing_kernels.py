"""Overlaps of all rectangles of the same image, compiled: only the pairs that are near are kept."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled

__all__ = ["overlapping_pairs"]

_ROWS = "Array(int64, 1, 'C', True)"
_RECTANGLES = "Array(float32, 2, 'C', True)"


@compiled(f"Tuple((int64[::1], int64[::1], float64[::1]))({_RECTANGLES}, {_ROWS}, {_RECTANGLES}, {_ROWS}, float64)")
def overlapping_pairs(
    first: F32, first_images: I64, second: F32, second_images: I64, min_giou: float
) -> tuple[I64, I64, F64]:
    """Pairs of rectangles of the same image with a generalised IoU (`core.geometry.boxes`) of at least `min_giou`.

    Args:
        first: (A, 4) left, top, right, bottom, pixels.
        first_images: (A,) rising.
        second: (B, 4).
        second_images: (B,) rising.
        min_giou: Above -1.

    Returns:
        (Q,) rows of the first, (Q,) rows of the second, ordered by both, and (Q,) their plain IoU.
    """
    rows, others, ious = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    for is_counted in (False, True):  # how many there are, and then which
        count, start = 0, 0
        for a in range(len(first)):
            while start < len(second) and second_images[start] < first_images[a]:
                start += 1
            left_a, top_a = np.float64(first[a, 0]), np.float64(first[a, 1])
            right_a, bottom_a = np.float64(first[a, 2]), np.float64(first[a, 3])
            b = start
            while b < len(second) and second_images[b] == first_images[a]:
                left_b, top_b = np.float64(second[b, 0]), np.float64(second[b, 1])
                right_b, bottom_b = np.float64(second[b, 2]), np.float64(second[b, 3])
                around_x = max(right_a, right_b) - min(left_a, left_b)
                around_y = max(bottom_a, bottom_b) - min(top_a, top_b)
                is_sound = right_a > left_a and bottom_a > top_a and right_b > left_b and bottom_b > top_b
                if is_sound and np.isfinite(around_x) and np.isfinite(around_y):
                    shared_x = max(min(right_a, right_b) - max(left_a, left_b), 0.0)
                    shared = shared_x * max(min(bottom_a, bottom_b) - max(top_a, top_b), 0.0)
                    areas = (right_a - left_a) * (bottom_a - top_a) + (right_b - left_b) * (bottom_b - top_b)
                    union, whole = areas - shared, around_x * around_y
                    iou = shared / union
                    if iou - (whole - union) / whole >= min_giou:
                        if is_counted:
                            rows[count], others[count], ious[count] = a, b, iou
                        count += 1
                b += 1
        if not is_counted:
            rows, others, ious = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    return rows, others, ious
