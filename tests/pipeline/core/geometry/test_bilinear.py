"""Values between nodes, against the same for arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.clouds import Relief
from pipeline.core.geometry.bilinear import between

VALUES = np.random.default_rng(1).normal(size=(4, 6))


@given(x=st.floats(-2, 8), y=st.floats(-2, 6))
def test_as_for_arrays(x: float, y: float) -> None:
    assert between(VALUES, x, y) == Relief(np.zeros(2), 1.0, VALUES).offset_m(np.array([x, y]))


@pytest.mark.parametrize(("x", "y"), [(0, 0), (5, 0), (0, 3), (5, 3), (2, 1)])
def test_nodes_have_their_values(x: int, y: int) -> None:
    assert between(VALUES, x, y) == VALUES[y, x]
