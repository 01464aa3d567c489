"""The surface of the ground, against numpy and scipy on whole grids."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from pipeline.core.arrays import F64
from pipeline.core.clouds import Relief
from pipeline.filters.relief_surface import grown, smooth

ABOVE_M, ABOVE_WEIGHT, MOST, PRIOR, NOTHING = 0.1, 0.25, 2.0, 0.05, 0.02


def values(seed: int, shape: tuple[int, int] = (9, 12)) -> F64:
    return np.random.default_rng(seed).normal(0, 0.1, shape)


def smoothed(grid: F64, taps: list[float], margin: int) -> F64:
    result = np.full([edge + 2 * margin for edge in grid.shape], np.nan)
    smooth(grid, np.array(taps), margin, result.reshape(-1))
    return result


@pytest.mark.parametrize("taps", [[1.0], [0.5, 0.25], [0.2, 0.1, 0.05, 0.02, 0.01]])
@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (9, 12), (30, 3)])
@pytest.mark.parametrize("more", [0, 1, 3])
def test_smoothed_is_a_sum_over_both_axes(taps: list[float], shape: tuple[int, int], more: int) -> None:
    margin = len(taps) - 1 + more
    line = [taps[abs(step)] for step in range(1 - len(taps), len(taps))]
    rows = np.apply_along_axis(np.convolve, 0, values(1, shape), line)
    expected = np.pad(np.apply_along_axis(np.convolve, 1, rows, line), more)
    np.testing.assert_allclose(smoothed(values(1, shape), taps, margin), expected, rtol=0, atol=1e-15)


def test_smoothed_is_scipys_gaussian_bit_for_bit() -> None:
    weights = np.exp(-0.5 / 2.0**2 * np.arange(-5, 6) ** 2)
    expected = gaussian_filter(np.pad(values(2), 7), 2.0, mode="constant", truncate=2.5)
    np.testing.assert_array_equal(smoothed(values(2), (weights / weights.sum())[5:].tolist(), 7), expected)


def grown_on_the_whole_grid(xy: F64, height: F64, side: int, rounds: list[tuple[list[float], float]]) -> F64:
    """The same by array operations, of which the last two smoothings are those without a limit."""

    def spread(grid: F64, taps: list[float]) -> F64:
        return smoothed(grid, taps, 12)[12:-12, 12:-12]

    node = np.rint(xy[:, 1]).astype(int) * side + np.rint(xy[:, 0]).astype(int)
    surface = np.zeros((side, side))
    for taps, near_m in rounds[:-2]:
        above = height - Relief(np.zeros(2), 1.0, surface).offset_m(xy)
        pull = np.where(above > ABOVE_M, ABOVE_WEIGHT, 1.0) * (np.abs(above) <= near_m)
        total = np.bincount(node, pull, side**2).reshape(side, side)
        mean = np.bincount(node, pull * above, side**2).reshape(side, side) / np.maximum(total, 1e-9)
        weight = np.minimum(total, MOST)
        surface = surface + spread(weight * mean, taps) / (spread(weight, taps) + PRIOR)
    known, (fill, _), (trust, _) = weight / MOST, *rounds[-2:]
    filled = spread(known * surface, fill) / (spread(known, fill) + NOTHING)
    trusted = spread(known, trust)
    trusted = trusted / (trusted + NOTHING)
    return np.asarray(trusted * surface + (1 - trusted) * filled)


@given(
    count=st.sampled_from([0, 1, 2, 400]),
    side=st.sampled_from([2, 21, 40]),
    low=st.floats(0, 1),
    high=st.floats(0, 1),
    seed=st.integers(0, 99),
)
def test_a_surface_grows_round_by_round(count: int, side: int, low: float, high: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(min(low, high) * (side - 1), max(low, high) * (side - 1), (count, 2))
    height = rng.normal(0, 0.2, count)
    rounds = [([0.1] * 9, 0.5), ([0.4, 0.2, 0.1], 0.3), ([1.0], 0.2), ([0.1] * 11, 0.0), ([0.5, 0.2], 0.0)]
    found = grown(
        xy,
        height,
        side,
        np.concatenate([taps for taps, _ in rounds]),
        np.array([len(taps) for taps, _ in rounds]),
        np.array([near_m for _, near_m in rounds[:-2]]),
        np.array([ABOVE_M, ABOVE_WEIGHT, MOST, PRIOR, NOTHING]),
    )
    np.testing.assert_array_equal(found, grown_on_the_whole_grid(xy, height, side, rounds))
