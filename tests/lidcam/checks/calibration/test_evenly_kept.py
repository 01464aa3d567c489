"""A few items of many, spread over all of them."""

import pytest

from lidcam.checks.calibration.evenly_kept import EvenlyKept


@pytest.mark.parametrize(
    ("count", "kept"),
    [(0, []), (1, [0]), (4, [0, 1, 2, 3]), (5, [0, 2, 4]), (7, [0, 2, 4, 6]), (9, [0, 4, 8]), (40, [0, 16, 32])],
)
def test_every_second_one_is_discarded_where_there_are_more(count: int, kept: list[int]) -> None:
    items = EvenlyKept[int](4)
    for item in range(count):
        items.add(item)
    assert [*items] == kept
