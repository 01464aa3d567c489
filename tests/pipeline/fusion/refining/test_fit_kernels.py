"""The passes of refinement against the same in array arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.refining.fit_kernels import averaged_states, boxes_at, normal_equations

from pipeline.core.arrays import F64, I64

REST = [0, 1, 3, 4, 5, 6]
BORDER, CAUCHY = 3.0, 2.5


def positive(random: np.random.Generator, *shape: int) -> F64:
    roots = random.normal(size=(*shape, shape[-1]))
    return np.asarray(roots @ np.swapaxes(roots, -1, -2) + np.eye(shape[-1]))


def rows_of(random: np.random.Generator, boxes: int, pairs: int) -> I64:
    return np.sort(random.integers(boxes, size=pairs)) if boxes else np.zeros(0, np.int64)


sizes = st.tuples(st.integers(0, 3), st.integers(1, 5), st.integers(0, 9))


@given(st.integers(0, 2**31), sizes)
def test_boxes_at_the_states(seed: int, size: tuple[int, int, int]) -> None:
    random, (n, tried, pairs) = np.random.default_rng(seed), size
    rows = rows_of(random, n, pairs)
    states, later_s = random.normal(size=(n, tried, 7)), random.normal(size=len(rows))
    centers, extents, yaws = random.normal(size=(n, 3)), random.uniform(1, 4, (n, 3)), random.uniform(-3, 3, n)
    cos, sin = np.cos(yaws), np.sin(yaws)
    found = boxes_at(states, rows, later_s, centers, extents, yaws, cos, sin, 0.5, 1.5)
    own, later = states[rows].reshape(-1, 7), np.repeat(later_s, tried)
    many = np.repeat(rows, tried)
    away = np.stack([[cos, -sin], [sin, cos]]).transpose(2, 0, 1)[many] @ (own[:, 5:, None] * later[:, None, None])
    np.testing.assert_allclose(found[0][:, :2], centers[many, :2] + own[:, :2] + away[..., 0], atol=1e-12)
    np.testing.assert_array_equal(found[0][:, 2], centers[many, 2])
    grown = np.clip(extents[many, :2] + own[:, 3:5], 0.5 * extents[many, :2], 1.5 * extents[many, :2])
    np.testing.assert_allclose(found[1], np.column_stack([grown, extents[many, 2]]))
    np.testing.assert_allclose(found[2], yaws[many] + own[:, 2])


@given(st.integers(0, 2**31), sizes)
def test_systems_to_solve(seed: int, size: tuple[int, int, int]) -> None:
    random, (n, tried, pairs) = np.random.default_rng(seed), size
    rows = rows_of(random, n, pairs)
    pairs = len(rows)
    states, information, later_s = random.normal(size=(n, tried, 7)), positive(random, n, 7), random.normal(size=pairs)
    edges, jacobian = random.uniform(-9, 59, (pairs * tried, 4)), random.normal(size=(pairs * tried, 4, 7))
    measured, sigma = random.uniform(0, 50, (pairs, 4)), random.uniform(1, 6, (pairs, 4))
    limits, yaws = np.full((pairs, 4), 50.0), random.uniform(-3, 3, n)
    cos, sin = np.cos(yaws), np.sin(yaws)
    found = normal_equations(
        states, information, rows, edges, jacobian, measured, sigma, limits, later_s, cos, sin, BORDER, CAUCHY
    )

    near = np.minimum(measured, limits - measured) < BORDER * sigma
    measured, sigma, limits, near = (np.repeat(values, tried, 0) for values in (measured, sigma, limits, near))
    residuals = (measured - np.where(near, np.clip(edges, 0, limits), edges)) / sigma
    squared = (residuals / CAUCHY) ** 2
    many, later = np.repeat(rows, tried), np.repeat(later_s, tried)[:, None]
    by_x, by_y, turn_x, turn_y = jacobian[..., 0], jacobian[..., 1], cos[many, None], sin[many, None]
    speeds = (by_x * turn_x + by_y * turn_y) * later, (by_y * turn_x - by_x * turn_y) * later
    slopes = np.concatenate([jacobian[..., [0, 1, 3, 4]], np.stack(speeds, -1)], -1) / sigma[..., None]
    slopes[near & ((edges < 0) | (edges > limits))] = 0.0
    weighed = slopes / (1 + squared)[..., None]
    normal, pull, cost = np.zeros((n, tried, 6, 6)), np.zeros((n, tried, 6)), np.zeros((n, tried))
    np.add.at(normal, rows, np.einsum("pea,peb->pab", weighed, slopes).reshape(-1, tried, 6, 6))
    np.add.at(pull, rows, np.einsum("pea,pe->pa", weighed, residuals).reshape(-1, tried, 6))
    np.add.at(cost, rows, CAUCHY**2 * np.log1p(squared).sum(1).reshape(-1, tried))
    drawn_back = np.einsum("nij,nkj->nki", information, states)
    np.testing.assert_allclose(found[0], normal + information[:, None][..., REST, :][..., REST], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[1][..., 0], pull - drawn_back[..., REST], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(found[1][..., 1:], np.broadcast_to(np.eye(6), (n, tried, 6, 6)))
    np.testing.assert_allclose(found[2], cost + (drawn_back * states).sum(2), rtol=1e-9, atol=1e-9)


@given(st.integers(0, 2**31), sizes)
def test_averages(seed: int, size: tuple[int, int, int]) -> None:
    random, (n, tried, _) = np.random.default_rng(seed), size
    states, log_odds = random.normal(size=(n, tried, 7)), random.normal(0, 5, (n, tried))
    within, about = positive(random, n, tried, 6), random.uniform(0, 1, n)
    mean, covariances = averaged_states(states, log_odds, within, about)
    weights = np.exp(log_odds - log_odds.max(1, keepdims=True))
    weights /= weights.sum(1, keepdims=True)
    np.testing.assert_allclose(mean, np.einsum("nk,nki->ni", weights, states), atol=1e-12)
    apart = states - mean[:, None]
    expected = np.einsum("nk,nki,nkj->nij", weights, apart, apart)
    expected[:, np.array(REST)[:, None], REST] += np.einsum("nk,nkij->nij", weights, within)
    expected[:, 2, 2] += about
    np.testing.assert_allclose(covariances, expected, atol=1e-12)


@pytest.mark.parametrize("odds", [np.nan, np.inf])
def test_what_is_no_number_stays_none(odds: float) -> None:
    mean, covariances = averaged_states(np.ones((1, 2, 7)), np.array([[odds, 1.0]]), np.ones((1, 2, 6, 6)), np.ones(1))
    assert not np.isfinite(mean).any()
    assert not np.isfinite(covariances).any()
