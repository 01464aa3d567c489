"""The assignment of rows to columns with the smallest sum of costs.

Compiled here, since importing `scipy.optimize` for one function would take a fifth of a program's start.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Indices
from lidcam.pipeline.core.compiled import compiled


def assign(costs: F64) -> tuple[Indices, Indices]:
    """Rows, rising, and the column of each: as many pairs as there can be, with the smallest sum of costs.

    Of equal sums, it chooses as `scipy.optimize.linear_sum_assignment` does.

    Args:
        costs: (R, C), finite.
    """
    if costs.shape[0] <= costs.shape[1]:
        columns = _columns_of_rows(np.ascontiguousarray(costs))
        return np.arange(len(columns)), columns
    rows = _columns_of_rows(np.ascontiguousarray(costs.T))
    order = np.argsort(rows)
    return rows[order], order


@compiled("int64[::1](float64[:, ::1])")
def _columns_of_rows(costs: F64) -> Indices:
    """(R,) the column of each row of costs (R, C), R <= C, by shortest augmenting paths.

    Crouse, On implementing 2D rectangular assignment algorithms, IEEE TAES 52(4), 2016.
    """
    row_count, column_count = costs.shape
    row_price, column_price = np.zeros(row_count), np.zeros(column_count)
    column_of, row_of = np.full(row_count, -1), np.full(column_count, -1)
    path, remaining = np.zeros(column_count, np.int64), np.zeros(column_count, np.int64)
    for added in range(row_count):
        shortest = np.full(column_count, np.inf)
        is_row_reached, is_column_reached = np.zeros(row_count, np.bool_), np.zeros(column_count, np.bool_)
        for place in range(column_count):
            remaining[place] = column_count - place - 1
        left, row, length, sink = column_count, added, 0.0, -1
        while sink < 0:
            is_row_reached[row] = True
            lowest, nearest = np.inf, 0
            for place in range(left):
                column = remaining[place]
                through = length + costs[row, column] - row_price[row] - column_price[column]
                if through < shortest[column]:
                    path[column], shortest[column] = row, through
                if shortest[column] < lowest or (shortest[column] == lowest and row_of[column] < 0):
                    lowest, nearest = shortest[column], place
            length, column = lowest, remaining[nearest]
            if row_of[column] < 0:
                sink = column
            else:
                row = row_of[column]
            is_column_reached[column] = True
            left -= 1
            remaining[nearest] = remaining[left]
        row_price[added] += length
        for row in range(row_count):
            if is_row_reached[row] and row != added:
                row_price[row] += length - shortest[column_of[row]]
        for column in range(column_count):
            if is_column_reached[column]:
                column_price[column] -= length - shortest[column]
        column, row = sink, -1
        while row != added:
            row = path[column]
            row_of[column] = row
            column_of[row], column = column, column_of[row]
    return column_of
