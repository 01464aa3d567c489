"""Assignment, compiled: shortest augmenting paths."""

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Indices
from pipeline.core.compiled import compiled, inlined

__all__ = ["best_of_pairs", "columns_of_classes", "columns_of_rows"]

_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@inlined
def _columns(costs: F64) -> Indices:
    """As `columns_of_rows`."""
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


@inlined
def _assigned(costs: F64) -> Indices:
    """(R,) column of each row, -1 for those that are left over, as `assignment.assign` of costs (R, C)."""
    row_count, column_count = costs.shape
    if row_count <= column_count:
        return _columns(costs)
    turned = np.empty((column_count, row_count))
    for row in range(row_count):
        for column in range(column_count):
            turned[column, row] = costs[row, column]
    rows, column_of = _columns(turned), np.full(row_count, -1)
    for column in range(column_count):
        column_of[rows[column]] = column
    return column_of


@inlined
def _numbered(marked: I64) -> int:
    """Give those places that are not negative their numbers, from 0, and return how many they are."""
    count = 0
    for place in range(len(marked)):
        if marked[place] >= 0:
            marked[place] = count
            count += 1
    return count


@compiled("int64[::1](float64[:, ::1])")
def columns_of_rows(costs: F64) -> Indices:
    """(R,) int64, the column of each row with the smallest sum of costs (R, C), of which there are R <= C.

    By Crouse's method ("On implementing 2D rectangular assignment algorithms", IEEE TAES 52(4), 2016), with scipy's
    choice among equal ones.
    """
    return _columns(costs)


@compiled(f"int64[::1]({_TABLE}, {_ROWS}, {_ROWS})")
def columns_of_classes(worth: F64, row_classes: I64, column_classes: I64) -> Indices:
    """(R,) int64, the column of each row in the assignment with the largest sum of worth, -1 for those without one.

    Rows are assigned to columns of their own class only, and where that has a worth.

    Args:
        worth: (R, C), not negative.
        row_classes: (R,) from 0.
        column_classes: (C,) from 0.
    """
    found, class_count = np.full(len(row_classes), -1), 0
    for column in range(len(column_classes)):
        class_count = max(class_count, column_classes[column] + 1)
    for class_id in range(class_count):
        rows, columns = np.flatnonzero(row_classes == class_id), np.flatnonzero(column_classes == class_id)
        if len(rows) == 0 or len(columns) == 0:
            continue
        costs = np.empty((len(rows), len(columns)))
        for r in range(len(rows)):
            for c in range(len(columns)):
                costs[r, c] = -worth[rows[r], columns[c]]
        column_of = _assigned(costs)
        for r in range(len(rows)):
            if column_of[r] >= 0 and costs[r, column_of[r]] < 0:
                found[rows[r]] = columns[column_of[r]]
    return found


@compiled(f"boolean[::1]({_ROWS}, {_ROWS}, {_ROWS}, {_LIST}, int64, int64)")
def best_of_pairs(rows: I64, columns: I64, groups: I64, worth: F64, row_count: int, column_count: int) -> Bools:
    """(Q,) which pairs belong to the assignment with the largest sum of worth, in each group by itself.

    Args:
        rows: (Q,) of each pair; a row is in one group.
        columns: (Q,) of each pair; a column is in one group.
        groups: (Q,) of each pair, those of one together.
        worth: (Q,) of each pair; without a positive one it is not taken.
        row_count: Rows are less than this.
        column_count: Columns are less than this.
    """
    taken = np.zeros(len(worth), np.bool_)
    of_row, of_column = np.zeros(row_count, np.int64), np.zeros(column_count, np.int64)
    for q in range(len(worth)):
        if worth[q] > 0:
            of_row[rows[q]] += 1
            of_column[columns[q]] += 1
    is_rival = np.zeros(len(worth), np.bool_)
    for q in range(len(worth)):
        taken[q] = worth[q] > 0 and of_row[rows[q]] == 1 and of_column[columns[q]] == 1
        is_rival[q] = worth[q] > 0 and not taken[q]
    start = 0
    while start < len(worth):
        end = start
        row_number, column_number = np.full(row_count, -1), np.full(column_count, -1)
        while end < len(worth) and groups[end] == groups[start]:
            if is_rival[end]:
                row_number[rows[end]], column_number[columns[end]] = 0, 0
            end += 1
        height, width = _numbered(row_number), _numbered(column_number)
        if height > 0:
            costs = np.zeros((height, width))
            for q in range(start, end):
                if is_rival[q]:
                    costs[row_number[rows[q]], column_number[columns[q]]] = -worth[q]
            column_of = _assigned(costs)
            for q in range(start, end):
                if is_rival[q]:
                    taken[q] = column_of[row_number[rows[q]]] == column_number[columns[q]]
        start = end
    return taken
