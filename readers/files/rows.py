"""Tables of one row a message, which may have millions: sorted, compared and counted with little memory beside them."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.core.arrays import I64

__all__ = ["counts_of", "in_order", "least_by", "sort_rows"]

ROWS_AT_ONCE = 1 << 16


def in_order(rows: I64, columns: Sequence[int]) -> bool:
    """Whether rows are sorted by some of their columns, the first of these first.

    Args:
        rows: (N, C).
        columns: Which ones.
    """
    for first in range(0, len(rows) - 1, ROWS_AT_ONCE):
        block = rows[first : first + ROWS_AT_ONCE + 1]
        is_right = np.ones(len(block) - 1, bool)  # equal rows are
        for column in reversed(columns):
            before, behind = block[:-1, column], block[1:, column]
            is_right &= before == behind
            is_right |= before < behind
        if not is_right.all():
            return False
    return True


def sort_rows(rows: I64, columns: Sequence[int]) -> None:
    """Sort rows in place by some of their columns, the first of these first; rows equal in them keep their order.

    Args:
        rows: (N, C).
        columns: Which ones.
    """
    if in_order(rows, columns):
        return
    order = np.lexsort([rows[:, column] for column in reversed(columns)])
    for values in rows.T:
        values[:] = values[order]


def counts_of(values: I64) -> Counter[int]:
    """How often each value comes.

    Args:
        values: (N,).
    """
    counts: Counter[int] = Counter()
    for block in _blocks(values):
        found, numbers = np.unique(block, return_counts=True)
        counts.update(dict(zip(found.tolist(), numbers.tolist(), strict=True)))
    return counts


def least_by(keys: I64, values: I64) -> dict[int, int]:
    """The least value that each key has.

    Args:
        keys: (N,).
        values: (N,).
    """
    least: dict[int, int] = {}
    for these, theirs in zip(_blocks(keys), _blocks(values), strict=True):
        found, places = np.unique(these, return_inverse=True)
        smallest = np.full(len(found), np.iinfo(np.int64).max)
        np.minimum.at(smallest, places, theirs)
        for key, value in zip(found.tolist(), smallest.tolist(), strict=True):
            least[key] = min(value, least.get(key, value))
    return least


def _blocks(values: I64) -> Iterator[I64]:
    return (values[first : first + ROWS_AT_ONCE] for first in range(0, len(values), ROWS_AT_ONCE))
