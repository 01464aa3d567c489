"""Tables of one row a message, which may have millions: sorted, compared and counted with little memory beside them."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from pipeline.core.arrays import I64

__all__ = ["RowsByKey", "counts_of", "in_order", "least_by", "sort_rows"]

ROWS_AT_ONCE = 1 << 16


class RowsByKey:
    """Finds the rows of some keys, in time proportional to their number; four bytes a row from the first search on.

    Args:
        keys: (N,) of the rows.
    """

    def __init__(self, keys: I64) -> None:
        self._keys = keys
        self._by_key: dict[int, np.ndarray[tuple[int], np.dtype[np.uint32]]] | None = None

    def of(self, wanted: Collection[int], span: I64) -> I64:
        """The rows of the keys `wanted`, rising.

        Args:
            wanted: Keys; those that no row has are ignored.
            span: First row that is looked at, and the first one behind.
        """
        if self._by_key is None:
            self._by_key = self._sorted()
        parts = [self._by_key[key] for key in wanted if key in self._by_key]
        parts = [part[slice(*np.searchsorted(part, span).tolist())] for part in parts]
        found = np.concatenate([np.zeros(0, np.int64), *parts])
        found.sort(kind="stable")
        return found

    def _sorted(self) -> dict[int, np.ndarray[tuple[int], np.dtype[np.uint32]]]:
        least = int(self._keys.min()) if len(self._keys) else 0
        is_small = bool(len(self._keys)) and self._keys.max() - least < 1 << 16
        keys = (self._keys - least).astype(np.uint16) if is_small else self._keys  # quicker to sort
        order = np.argsort(keys, kind="stable").astype(np.uint32)
        starts = np.r_[0, np.flatnonzero(np.diff(self._keys[order])) + 1][: len(order)]
        parts = np.split(order, starts[1:])
        return {int(self._keys[part[0]]): part for part in parts if len(part)}


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
