"""Selection of rows of records of parallel arrays, and runs of equal values."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import F64, I64, CheckedTable, Names, Rows, check_array, first_of_runs, select_rows


@dataclass(frozen=True, slots=True, eq=False)
class Inner:
    values: I64

    def select(self, rows: Rows) -> "Inner":
        return select_rows(self, rows)


@dataclass(frozen=True, eq=False)
class Outer:
    name: str
    places: F64
    inner: Inner
    free: I64
    missing: None = None

    def __post_init__(self) -> None:
        check_array("places", self.places, (len(self.places), 2), np.float64)


def outer() -> Outer:
    return Outer("some", np.arange(6.0).reshape(3, 2), Inner(np.array([5, 6, 7])), np.array([1, 2, 3]))


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (np.array([2, 0, 0]), [2, 0, 0]),
        (np.array([True, False, True]), [0, 2]),
        (np.zeros(0, np.intp), []),
        (np.zeros(3, np.bool_), []),
    ],
)
def test_rows_of_arrays_and_of_records_in_records(rows: Rows, expected: list[int]) -> None:
    record = outer()
    found = select_rows(record, rows)
    assert (type(found), found.name, found.missing) == (Outer, "some", None)
    np.testing.assert_array_equal(found.places, record.places[expected])
    np.testing.assert_array_equal(found.free, record.free[expected])
    np.testing.assert_array_equal(found.inner.values, record.inner.values[expected])


def test_what_is_read_only_stays_so() -> None:
    found = select_rows(outer(), np.array([1]))
    assert not found.places.flags.writeable
    assert found.free.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        found.places[0] = 1.0


def test_masks_of_another_length_are_refused() -> None:
    with pytest.raises(IndexError, match=r"a mask of 2 rows for arrays of \[3\]"):
        select_rows(outer(), np.ones(2, np.bool_))


@given(st.lists(st.integers(0, 2)))
def test_runs_begin_where_a_value_differs_from_the_one_before(values: list[int]) -> None:
    found = first_of_runs(np.array(values, np.int64))
    assert found.tolist() == [k == 0 or values[k] != values[k - 1] for k in range(len(values))]


@dataclass(frozen=True, slots=True, eq=False)
class Posts(CheckedTable):
    ROWS: ClassVar = {"places": (2,)}

    site: str
    places: F64
    numbers: I64
    names: Names
    extra: F64 | None = None  # not checked


@dataclass(frozen=True, slots=True, eq=False)
class Painted(CheckedTable):
    posts: Posts
    colors: I64


def test_arrays_of_a_table_are_as_declared_and_read_only() -> None:
    posts = Posts("yard", np.ones((2, 2)), np.arange(2), np.array(["a", "bcd"]), np.ones(7))
    assert (len(posts), len(Painted(posts, np.arange(2))), len(posts.select(np.array([1])))) == (2, 2, 1)
    assert not posts.places.flags.writeable
    arrays: tuple[tuple[str, Any], ...] = (
        ("places", np.ones((2, 3))),
        ("numbers", np.arange(3)),
        ("numbers", np.ones(2)),
        ("names", np.arange(2)),
    )
    for field, wrong in arrays:
        with pytest.raises(ValueError, match=rf"^{field}: expected "):
            replace(posts, **{field: wrong})
    with pytest.raises(ValueError, match=r"^colors: expected int64"):
        Painted(posts, np.arange(3))


def test_a_table_of_zeros() -> None:
    posts = Posts.zeros(3, site="yard")
    assert (posts.places.shape, str(posts.numbers.dtype), posts.names.tolist()) == ((3, 2), "int64", ["", "", ""])
