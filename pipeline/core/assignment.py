"""The assignment of rows to columns with the smallest sum of costs."""

import numpy as np

from pipeline.core.arrays import F64, Indices

__all__ = ["assign"]


def assign(costs: F64) -> tuple[Indices, Indices]:
    """Rows, rising, and the column of each: as many pairs as there can be, with the smallest sum of costs.

    By Crouse's method ("On implementing 2D rectangular assignment algorithms", IEEE TAES 52(4), 2016), in scipy.

    Args:
        costs: (R, C), finite.
    """
    if 1 in costs.shape:  # most are: they are solved without scipy.optimize, which takes a third of a second to import
        row, column = np.unravel_index([np.argmin(costs)], costs.shape) if costs.size else np.zeros((2, 0), np.intp)
        return row, column
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(costs)
    return rows, columns
