import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from lidcam.pipeline.fusion.assignment import assign


@given(st.integers(0, 7), st.integers(0, 7), st.integers(0, 2**32 - 1), st.booleans())
def test_it_chooses_as_scipy(rows: int, columns: int, seed: int, has_equal_sums: bool) -> None:
    random = np.random.default_rng(seed)
    costs = random.normal(size=(rows, columns))
    if has_equal_sums:
        costs = np.round(costs)
    for found, expected in zip(assign(costs), linear_sum_assignment(costs), strict=True):
        np.testing.assert_array_equal(found, expected)
