"""Tables that grow by pieces."""

from dataclasses import dataclass

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.evaluation.pieces import MAX_LOOSE, Pieces


@dataclass(frozen=True)
class Rows:
    """N rows: numbers (N,), places (N, 2)."""

    numbers: I64
    places: F64


def rows(first: int, count: int) -> Rows:
    numbers = np.arange(first, first + count)
    return Rows(numbers, np.column_stack([numbers, -numbers]).astype(np.float64))


@pytest.mark.parametrize("count", [0, 1, MAX_LOOSE - 1, MAX_LOOSE, 2 * MAX_LOOSE + 3])
def test_all_rows_in_their_order_however_often_it_is_read(count: int) -> None:
    pieces = Pieces(Rows, places=(2,))
    for row in range(count):
        pieces.append(rows(2 * row, 2))
        if row == 5:
            assert len(pieces.table().numbers) == 12
    expected = rows(0, 2 * count)
    for _ in range(2):
        found = pieces.table()
        np.testing.assert_array_equal(found.numbers, expected.numbers)
        np.testing.assert_array_equal(found.places, expected.places)
