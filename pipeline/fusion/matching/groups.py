"""Pairs of rows that belong together."""

import numpy as np

from pipeline.core.arrays import I64

__all__ = ["pairs_within"]


def pairs_within(first: I64, second: I64) -> tuple[I64, I64]:
    """All pairs of rows that belong to the same group.

    Args:
        first: (A,) group of each row, rising.
        second: (B,) group of each row, rising.

    Returns:
        (Q,) rows of the first and (Q,) rows of the second, ordered by both.
    """
    starts = np.searchsorted(second, first, side="left")
    partners = np.searchsorted(second, first, side="right") - starts
    rows = np.repeat(np.arange(len(first)), partners)
    offsets = np.arange(len(rows)) - np.repeat(np.cumsum(partners) - partners, partners)
    return rows, starts[rows] + offsets
