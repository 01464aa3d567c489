import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.small_matrices import inverse, solve


@given(st.integers(0, 2**31), st.integers(1, 7), st.sampled_from([(), (3,), (2, 4)]))
def test_solutions_are_those_of_lapack(seed: int, size: int, shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(*shape, size, size))
    matrices = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(size)
    right = random.normal(size=(*shape, size, 2))
    found, log_det = solve(matrices, right)
    np.testing.assert_allclose(found, np.linalg.solve(matrices, right), rtol=1e-6)
    np.testing.assert_allclose(log_det, np.linalg.slogdet(matrices)[1], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(inverse(matrices), np.linalg.inv(matrices), rtol=1e-6, atol=1e-8)


def test_what_is_not_positive_is_told() -> None:
    _, log_det = solve(np.stack([np.eye(2), -np.eye(2), np.zeros((2, 2))]), np.ones((3, 2, 1)))
    assert np.isfinite(log_det).tolist() == [True, False, False]


@pytest.mark.parametrize("count", [0, 1])
def test_few(count: int) -> None:
    assert inverse(np.tile(np.eye(4), (count, 1, 1))).shape == (count, 4, 4)
