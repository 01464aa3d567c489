import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pipeline.fusion.assignment import assign
from scipy.optimize import linear_sum_assignment

from pipeline.core.arrays import F64

TABLES = arrays(
    np.float64,
    array_shapes(min_dims=2, max_dims=2, max_side=6),
    elements=st.sampled_from([-3.0, -0.5, 0.0, 0.25, 1.0]) | st.floats(-1e6, 1e6),
)
"""Many with equal costs."""


@given(TABLES)
def test_answer_is_that_of_scipy_ties_included(costs: F64) -> None:
    for found, expected in zip(assign(costs), linear_sum_assignment(costs), strict=True):
        assert found.tolist() == expected.tolist()


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0), (0, 1), (1, 0)])
def test_nothing_to_assign(shape: tuple[int, int]) -> None:
    rows, columns = assign(np.zeros(shape))
    assert rows.dtype == columns.dtype == np.intp
    assert len(rows) == len(columns) == 0
