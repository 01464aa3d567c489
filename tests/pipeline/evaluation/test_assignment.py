from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.evaluation.assignment import assign_heaviest, assign_nearest, conflicts

EDGES = st.dictionaries(
    st.tuples(st.integers(0, 5), st.integers(0, 5)), st.floats(0.01, 2.0).map(lambda value: round(value, 3)), max_size=9
)
Edges = dict[tuple[int, int], float]


def arrays(edges: Edges) -> tuple[I64, I64, F64]:
    rows = np.array(sorted(edges), np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1], np.array([edges[key] for key in sorted(edges)], np.float64)


def is_matching(first: I64, second: I64) -> bool:
    return len(set(first.tolist())) == len(set(second.tolist())) == len(first)


def all_matchings(first: I64, second: I64) -> list[list[int]]:
    sets = (list(rows) for size in range(len(first) + 1) for rows in combinations(range(len(first)), size))
    return [rows for rows in sets if is_matching(first[rows], second[rows])]


def chosen_rows(chosen: Bools) -> list[int]:
    return [int(row) for row in np.flatnonzero(chosen)]


@given(EDGES)
def test_nearest_is_the_best_of_all_sets(edges: Edges) -> None:
    first, second, distances = arrays(edges)
    rows = chosen_rows(assign_nearest(first, second, distances))
    assert is_matching(first[rows], second[rows])
    best = min((-len(rows), distances[rows].sum()) for rows in all_matchings(first, second))
    assert len(rows) == -best[0]
    np.testing.assert_allclose(distances[rows].sum(), best[1], atol=1e-9)


@given(EDGES)
def test_heaviest_is_the_best_of_all_sets(edges: Edges) -> None:
    first, second, weights = arrays(edges)
    rows = chosen_rows(assign_heaviest(first, second, weights))
    assert is_matching(first[rows], second[rows])
    best = max(weights[rows].sum() for rows in all_matchings(first, second))
    np.testing.assert_allclose(weights[rows].sum(), best, atol=1e-9)


@given(EDGES)
def test_components_share_no_row_and_come_in_order(edges: Edges) -> None:
    first, second, _ = arrays(edges)
    parts = [part.tolist() for part in conflicts(first, second)]
    assert sorted(row for part in parts for row in part) == list(range(len(first)))
    assert parts == sorted(parts)
    for one, other in combinations(parts, 2):
        assert not set(first[one]) & set(first[other])
        assert not set(second[one]) & set(second[other])
