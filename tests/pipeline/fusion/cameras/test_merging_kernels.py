"""Mixtures and their combination in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.cameras.merging_kernels import combine, mixture_means, near_worth

from pipeline.core.arrays import F64

HEADINGS = 12
DIRECTIONS = np.random.default_rng(0).normal(size=(2, HEADINGS))


def made_up(seed: int, count: int) -> tuple[F64, F64]:
    """Places (P, H, 2) and covariances (P, H, 2, 2)."""
    random = np.random.default_rng(seed)
    root = random.normal(0, 1, (count, HEADINGS, 2, 2))
    return random.normal(0, 20, (count, HEADINGS, 2)), root @ root.swapaxes(-1, -2) + 0.1 * np.eye(2)


@pytest.mark.parametrize("count", [0, 1, 9])
def test_moments_of_mixtures(count: int) -> None:
    xy, covariances = made_up(1, count)
    weights = np.random.default_rng(2).random((count, HEADINGS)) + 1e-3
    share = weights / weights.sum(1, keepdims=True)
    mean = (share[..., None] * xy).sum(1)
    gap = xy - mean[:, None]
    spread = (share[..., None, None] * (covariances + gap[..., :, None] * gap[..., None, :])).sum(1)
    found = mixture_means(weights, xy, covariances, DIRECTIONS)
    expected = mean, spread, *((share * direction).sum(1) for direction in DIRECTIONS)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("headings", [1, 7, 8, 9, 16, 100])
def test_sums_are_numpys(headings: int) -> None:
    random = np.random.default_rng(headings)
    weights, direction = random.random((1, headings)), random.normal(size=(2, headings))
    _, _, x, y = mixture_means(weights, np.zeros((1, headings, 2)), np.zeros((1, headings, 2, 2)), direction)
    share = weights / weights.sum(1)
    assert (x[0], y[0]) == ((share[0] * direction[0]).sum(), (share[0] * direction[1]).sum())


def test_squared_distances_within_the_gate() -> None:
    xy, covariances = made_up(3, 15)
    first, second = (xy[:6, 0].copy() / 5, covariances[:6, 0].copy()), (xy[6:, 0].copy() / 5, covariances[6:, 0].copy())
    found = near_worth(*first, *second, 13.8)
    gap = second[0] - first[0][:, None]
    inverse = np.linalg.inv(first[1][:, None] + second[1])
    expected = np.maximum(13.8 - np.einsum("rci,rcij,rcj->rc", gap, inverse, gap), 0.0)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert 0 < (found > 0).sum() < found.size


def test_combined_as_independent_normal_distributions() -> None:
    known_xy, known = made_up(4, 5)
    new_xy, new = made_up(5, 3)
    rows, new_rows = np.array([4, 1]), np.array([0, 2])
    xy, covariances = known_xy.copy(), known.copy()
    squares, determinants = combine(xy, covariances, new_xy, new, rows, new_rows)
    p, q, gap = known[rows], new[new_rows], new_xy[new_rows] - known_xy[rows]
    gain = p @ np.linalg.inv(p + q)
    np.testing.assert_allclose(xy[rows], known_xy[rows] + (gain @ gap[..., None])[..., 0], rtol=1e-9)
    np.testing.assert_allclose(covariances[rows], np.linalg.inv(np.linalg.inv(p) + np.linalg.inv(q)), rtol=1e-7)
    np.testing.assert_array_equal(covariances, covariances.swapaxes(-1, -2))
    np.testing.assert_allclose(squares, np.einsum("thi,thij,thj->th", gap, np.linalg.inv(p + q), gap), rtol=1e-9)
    np.testing.assert_allclose(determinants, np.linalg.det(p + q), rtol=1e-9)
    others = [0, 2, 3]
    np.testing.assert_array_equal(xy[others], known_xy[others])
