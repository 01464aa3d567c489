"""Tables of one row a message: sorted, compared and counted as numpy's own functions do, with less memory."""

import tracemalloc
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.arrays import I64
from readers.files import rows as module
from readers.files.rows import RowsByKey, counts_of, in_order, least_by, sort_rows

TABLES = st.lists(st.tuples(*[st.integers(0, 3)] * 3), max_size=12).map(lambda rows: np.array(rows, np.int64))


@given(TABLES, st.sampled_from([(0,), (1, 0), (0, 1, 2), (2, 1)]), st.sampled_from([1, 2, 5, 100]))
def test_same_as_numpy(table: I64, columns: tuple[int, ...], at_once: int) -> None:
    table = table.reshape(-1, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "ROWS_AT_ONCE", at_once)
        expected = table[np.lexsort([table[:, column] for column in reversed(columns)])]
        assert in_order(table, columns) == np.array_equal(table[:, columns], expected[:, columns])
        found = table.copy()
        sort_rows(found, columns)
        assert np.array_equal(found, expected)
        assert counts_of(table[:, 0]) == Counter(table[:, 0].tolist())
        pairs = sorted(zip(table[:, 0].tolist(), table[:, 1].tolist(), strict=True), reverse=True)
        assert least_by(table[:, 0], table[:, 1]) == dict(pairs)


def test_memory_beside_the_table() -> None:
    count = 400_000
    table = np.arange(4 * count).reshape(4, count).T
    tracemalloc.start()
    sort_rows(table, (0, 1))
    counts_of(table[:, 1] // count)
    least_by(table[:, 1] // count, table[:, 0])
    in_order_peak = tracemalloc.get_traced_memory()[1]
    table = table[::-1]
    tracemalloc.reset_peak()
    sort_rows(table, (0, 1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert in_order_peak < 20 * count  # the quotients, and blocks
    assert peak < 40 * count  # a column, its order, and what the sort needs
    assert in_order(table, (0, 1))


@given(st.lists(st.integers(-1, 3), max_size=12), st.sets(st.integers(-1, 4)), st.integers(0, 12), st.integers(0, 12))
@pytest.mark.parametrize("scale", [1, 1 << 20])
def test_rows_by_key(scale: int, keys: list[int], wanted: set[int], first: int, end: int) -> None:
    column = np.array(keys, np.int64) * scale
    expected = np.flatnonzero(np.isin(column, [key * scale for key in wanted]))
    rows = RowsByKey(column)
    for span in ((0, len(keys)), (first, end)):
        found = rows.of([key * scale for key in wanted], np.array(span))
        assert found.tolist() == expected[(expected >= span[0]) & (expected < span[1])].tolist()
