"""Tables that grow frame by frame."""

from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from lidcam.pipeline.core.arrays import columns, join_rows

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MAX_LOOSE = 256
"""Largest number of separate pieces: an array of a few rows takes more memory than the rows."""

Table = TypeVar("Table", bound="DataclassInstance")


class Pieces(Generic[Table]):
    """A table, a dataclass of parallel arrays, that grows by pieces and is put together when it is read.

    `shapes` has the shape of one row by name of a column where the table does not declare it (`Table.ROWS`).
    """

    def __init__(self, kind: type[Table], **shapes: tuple[int, ...]) -> None:
        arrays = {one.name: np.zeros((0, *shapes.get(one.name, one.shape)), one.dtype) for one in columns(kind)}
        self._blocks, self._loose = [kind(**arrays)], list[Table]()

    def append(self, piece: Table) -> None:
        """Add the rows of `piece` at the end."""
        self._loose.append(piece)
        if len(self._loose) >= MAX_LOOSE:
            self._blocks.append(join_rows(*self._loose))
            self._loose.clear()

    def table(self) -> Table:
        """All rows."""
        if len(self._blocks) + len(self._loose) > 1:
            self._blocks = [join_rows(*self._blocks, *self._loose)]
            self._loose.clear()
        return self._blocks[0]
