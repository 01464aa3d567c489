"""Tables that grow frame by frame."""

from typing import TYPE_CHECKING, Generic, TypeVar

from lidcam.pipeline.core.arrays import join_rows

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MAX_LOOSE = 256
"""Pieces that stand by themselves at most: an array of a few rows takes more memory than the rows."""

Table = TypeVar("Table", bound="DataclassInstance")


class Pieces(Generic[Table]):
    """A table that grows by pieces, and is put together when it is read.

    Args:
        empty: The table without rows; a dataclass of parallel arrays.
    """

    def __init__(self, empty: Table) -> None:
        self._blocks, self._loose = [empty], list[Table]()

    def append(self, piece: Table) -> None:
        """Add the rows of `piece` at the end."""
        self._loose.append(piece)
        if len(self._loose) >= MAX_LOOSE:
            self._blocks.append(join_rows(*self._loose))
            self._loose.clear()

    def table(self) -> Table:
        """All rows so far."""
        if len(self._blocks) + len(self._loose) > 1:
            self._blocks = [join_rows(*self._blocks, *self._loose)]
            self._loose.clear()
        return self._blocks[0]
