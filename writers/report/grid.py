"""A map of counts seen from above, whose cells grow with what lies in it."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64

MAX_CLOUDS = 48
"""Clouds of the background, evenly over the recording."""

FIRST_CELL_M = 0.02
"""Side of a cell of the background at first."""

MAX_CELLS = 150_000
"""Cells of the background."""

_MIDDLE = 1 << 30
"""Column and row of the origin: both fit into 31 bits and stand together in one key."""


class SparseGrid:
    """Counts by square cell, of this side at first; where there are too many cells, four become one."""

    def __init__(self, cell_m: float, max_cells: int) -> None:
        self.cell_m, self._max_cells = cell_m, max_cells
        self._keys: I64 = np.zeros(0, np.int64)
        self.counts: I64 = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return len(self._keys)

    def add_points(self, xy: F64) -> None:
        """Count each cell in which some of the points (N, 2) lie once."""
        cells = np.clip(np.floor(xy / self.cell_m), 1 - _MIDDLE, _MIDDLE - 1).astype(np.int64) + _MIDDLE
        keys = np.unique(cells[:, 0] << 32 | cells[:, 1])
        self._merge(np.concatenate([self._keys, keys]), np.concatenate([self.counts, np.ones(len(keys), np.int64)]))
        while len(self._keys) > self._max_cells:
            self.cell_m *= 2
            halved = (self._cells - _MIDDLE) // 2 + _MIDDLE
            self._merge(halved[:, 0] << 32 | halved[:, 1], self.counts)

    @property
    def centers(self) -> F64:
        """(M, 2) middle of each cell with a count, metres."""
        return (self._cells - _MIDDLE + 0.5).astype(np.float64) * self.cell_m

    @property
    def _cells(self) -> I64:
        return np.stack([self._keys >> 32, self._keys & 0xFFFFFFFF], 1)

    def _merge(self, keys: I64, counts: I64) -> None:
        self._keys, rows = np.unique(keys, return_inverse=True)
        self.counts = np.bincount(rows, counts, len(self._keys)).astype(np.int64)
