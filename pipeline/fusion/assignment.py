"""The assignment of rows to columns with the smallest sum of costs.

In C++, since importing `scipy.optimize` for one function would take a fifth of a program's start.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Indices
from lidcam.pipeline.native.kernels import columns_of_rows


def assign(costs: F64) -> tuple[Indices, Indices]:
    """Rows, rising, and the column of each: as many pairs as there can be, with the smallest sum of costs.

    Of equal sums, it chooses as `scipy.optimize.linear_sum_assignment` does.

    Args:
        costs: (R, C), finite.
    """
    if costs.shape[0] <= costs.shape[1]:
        columns = columns_of_rows(np.ascontiguousarray(costs))
        return np.arange(len(columns)), columns
    rows = columns_of_rows(np.ascontiguousarray(costs.T))
    order = np.argsort(rows)
    return rows[order], order
