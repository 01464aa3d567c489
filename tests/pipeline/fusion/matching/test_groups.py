import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.fusion.matching.groups import pairs_within

groups = st.lists(st.integers(0, 3), max_size=6).map(sorted)


@given(groups, groups)
def test_pairs_are_those_of_a_loop(first: list[int], second: list[int]) -> None:
    rows, others = pairs_within(np.array(first, np.int64), np.array(second, np.int64))
    expected = [(i, j) for i, a in enumerate(first) for j, b in enumerate(second) if a == b]
    assert list(zip(rows.tolist(), others.tolist(), strict=True)) == expected
