import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.fusion.small_matrices import inverse, inverse_3x3, solve


@given(st.integers(0, 2**31), st.integers(1, 7), st.sampled_from([(), (3,), (2, 4)]))
def test_solutions_are_those_of_lapack(seed: int, size: int, shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(*shape, size, size))
    matrices = roots @ np.swapaxes(roots, -1, -2) + 0.1 * np.eye(size)
    right = random.normal(size=(*shape, size, 2))
    found, log_det = solve(np.moveaxis(matrices, (-2, -1), (0, 1)), np.moveaxis(right, (-2, -1), (0, 1)))
    np.testing.assert_allclose(np.moveaxis(found, (0, 1), (-2, -1)), np.linalg.solve(matrices, right), rtol=1e-6)
    np.testing.assert_allclose(log_det, np.linalg.slogdet(matrices)[1], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(inverse(matrices), np.linalg.inv(matrices), rtol=1e-6, atol=1e-8)


def test_inverses_of_three_by_three() -> None:
    roots = np.random.default_rng(1).normal(size=(5, 3, 3))
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(3)
    np.testing.assert_allclose(inverse_3x3(matrices), np.linalg.inv(matrices))


@pytest.mark.parametrize("count", [0, 1])
def test_few(count: int) -> None:
    assert inverse(np.tile(np.eye(4), (count, 1, 1))).shape == (count, 4, 4)
