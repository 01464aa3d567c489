"""Tables that grow frame by frame."""

from collections.abc import Collection, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = ["Pieces"]

MAX_LOOSE = 256
"""Pieces that stand by themselves at most: an array of a few rows takes more memory than the rows."""

Table = TypeVar("Table", bound="DataclassInstance")


class Pieces(Generic[Table]):
    """A table that grows by pieces, and is put together when it is read.

    Args:
        empty: The table without rows; a dataclass of arrays.
        by_criterion: Its arrays whose rows are the second axis: they hold something by criterion.
    """

    def __init__(self, empty: Table, by_criterion: Collection[str] = ()) -> None:
        self._blocks, self._loose = [empty], list[Table]()
        self._axes = {one.name: int(one.name in by_criterion) for one in fields(empty)}

    def append(self, piece: Table) -> None:
        """Add the rows of `piece` at the end."""
        self._loose.append(piece)
        if len(self._loose) >= MAX_LOOSE:
            self._blocks.append(self._joined(self._loose))
            self._loose.clear()

    def table(self) -> Table:
        """All rows so far."""
        if len(self._blocks) + len(self._loose) > 1:
            self._blocks = [self._joined([*self._blocks, *self._loose])]
            self._loose.clear()
        return self._blocks[0]

    def _joined(self, pieces: Sequence[Table]) -> Table:
        columns = {
            name: np.concatenate([getattr(piece, name) for piece in pieces], axis) for name, axis in self._axes.items()
        }
        return type(pieces[0])(**columns)
