"""Assignment by groups and classes, judged by scipy on each of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.assignment_kernels import best_of_pairs, columns_of_classes
from scipy.optimize import linear_sum_assignment

from pipeline.core.arrays import F64

WORTH = [-3.0, 0.0, 0.0, 0.5, 1.0, 1.25, 2.0, 4.0]


def best_sum(table: F64) -> float:
    return float(table[linear_sum_assignment(table, maximize=True)].sum())


@given(st.integers(0, 2**31), st.integers(0, 6), st.integers(0, 6), st.integers(1, 3))
def test_pairs_of_each_group(seed: int, height: int, width: int, groups: int) -> None:
    random = np.random.default_rng(seed)
    table = random.choice(WORTH, (groups, height, width))
    is_near = random.random(table.shape) < 0.6
    group, row, column = np.nonzero(is_near)
    rows, columns, worth = group * height + row, group * width + column, table[is_near]
    taken = best_of_pairs(rows, columns, np.ascontiguousarray(group), worth, groups * height, groups * width)
    for own in range(groups):
        mine = taken & (group == own)
        assert worth[mine].sum() == best_sum(np.where(is_near[own], np.maximum(table[own], 0), 0.0))
        assert len(set(rows[mine])) == len(set(columns[mine])) == mine.sum()
    assert (worth[taken] > 0).all()


@given(st.integers(0, 2**31), st.integers(0, 8), st.integers(0, 8))
def test_columns_are_of_the_class_of_their_rows(seed: int, height: int, width: int) -> None:
    random = np.random.default_rng(seed)
    worth = np.maximum(random.choice(WORTH, (height, width)), 0.0)
    own, other = random.integers(0, 3, height), random.integers(0, 4, width)
    found = columns_of_classes(worth, own, other)
    rows = np.flatnonzero(found >= 0)
    assert (own[rows] == other[found[rows]]).all()
    assert (worth[rows, found[rows]] > 0).all()
    assert len(set(found[rows].tolist())) == len(rows)
    assert worth[rows, found[rows]].sum() == sum(best_sum(worth[np.ix_(own == k, other == k)]) for k in range(3))
