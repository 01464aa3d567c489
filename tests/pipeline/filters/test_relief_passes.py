"""The compiled passes, against numpy and scipy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pipeline.core.arrays import F32, F64
from pipeline.core.clouds import Plane, Relief
from pipeline.filters.relief_passes import grown, lowest_of_cells, on_plane, on_relief, pull, smoothed

PLANE = np.array([0.05, -0.1, 0.9937303, 1.2], np.float32)


def points(count: int, *, half_m: float = 25.0) -> F32:
    rng = np.random.default_rng(count)
    x, y = rng.uniform(-half_m, half_m, (2, count))
    xyz = np.column_stack([x, y, -1.2 + 0.3 * rng.random(count)]).astype(np.float32)
    xyz.flags.writeable = False
    return xyz


def surface(seed: int, shape: tuple[int, int] = (9, 12)) -> F64:
    return np.random.default_rng(seed).normal(0, 0.1, shape)


@pytest.mark.parametrize("taps", [[1.0], [0.5, 0.25], [0.2, 0.1, 0.05, 0.02, 0.01]])
@pytest.mark.parametrize("shape", [(2, 2), (9, 12), (30, 3)])
def test_smoothed_is_a_sum_over_both_axes(taps: list[float], shape: tuple[int, int]) -> None:
    reach = len(taps) - 1
    line = [taps[abs(step)] for step in range(-reach, reach + 1)]
    values = surface(1, shape)
    rows = np.apply_along_axis(lambda column: np.convolve(column, line)[reach : reach + shape[0]], 0, values)
    expected = np.apply_along_axis(lambda row: np.convolve(row, line)[reach : reach + shape[1]], 1, rows)
    np.testing.assert_allclose(smoothed(values, np.array(taps)), expected, rtol=0, atol=1e-15)


def test_smoothed_is_scipys_gaussian_bit_for_bit() -> None:
    weights = np.exp(-0.5 / 2.0**2 * np.arange(-5, 6) ** 2)
    expected = gaussian_filter(surface(2), 2.0, mode="constant", truncate=2.5)
    np.testing.assert_array_equal(smoothed(surface(2), (weights / weights.sum())[5:]), expected)


@pytest.mark.parametrize("count", [0, 1, 4000])
def test_lowest_of_cells(count: int) -> None:
    xyz, side = points(count), 30
    middle, origin = np.array([1, -2], np.float32), np.array([-18, -20], np.float32)
    limits = np.float32(0.2), np.float32(0.08), np.float32(0.07)
    cells, means = lowest_of_cells(xyz, PLANE, middle, origin, np.float32(1.5), side, *limits)

    reach_m, slope, layer_m = limits
    a, b, c, d = PLANE
    height = (xyz[:, 0] * a + xyz[:, 1] * b + xyz[:, 2] * c + d) / c
    distance = np.sqrt(((xyz[:, :2] - middle) ** 2).sum(axis=1))
    column, row = np.floor((xyz[:, :2] - origin).T / np.float32(1.5)).astype(int)
    near = (np.abs(height) <= reach_m + slope * distance) & (column >= 0) & (column < side) & (row >= 0) & (row < side)
    expected = {}
    for cell in np.unique((row * side + column)[near]).tolist():
        heights = height[near & (row * side + column == cell)]
        expected[cell] = heights[heights <= heights.min() + layer_m].mean(dtype=np.float64)
    assert cells.tolist() == list(expected)
    np.testing.assert_allclose(means, list(expected.values()), rtol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 400])
def test_pull(count: int) -> None:
    rng = np.random.default_rng(count)
    relief = Relief(np.zeros(2), 1.0, surface(3))
    xy = rng.uniform(0, [11.4, 8.4], (count, 2))
    height = relief.offset_m(xy) + rng.normal(0, 0.2, count)
    total, mean = surface(4), surface(5)
    pull(xy, height, surface(3), 0.3, 0.1, 0.25, total, mean)

    above = height - relief.offset_m(xy)
    weight = np.where(above > 0.1, 0.25, 1.0) * (np.abs(above) <= 0.3)
    node = np.rint(xy[:, 1]).astype(int) * 12 + np.rint(xy[:, 0]).astype(int)
    sums = np.bincount(node, weight, 9 * 12)
    np.testing.assert_array_equal(total.ravel(), sums)
    np.testing.assert_array_equal(mean.ravel(), np.bincount(node, weight * above, 9 * 12) / np.maximum(sums, 1e-9))


@pytest.mark.parametrize("count", [0, 1, 400])
def test_a_surface_grows_round_by_round(count: int) -> None:
    rng, side = np.random.default_rng(count), 21
    xy, height = rng.uniform(0, side - 1.0, (count, 2)), rng.normal(0, 0.2, count)
    rounds = [(np.array([0.1] * 9), 0.5), (np.array([0.4, 0.2, 0.1]), 0.3), (np.array([1.0]), 0.2)]
    taps, counts = np.concatenate([one for one, _ in rounds]), np.array([len(one) for one, _ in rounds])
    found = grown(xy, height, side, taps, counts, np.array([m for _, m in rounds]), np.array([0.1, 0.25, 2.0, 0.05]))

    grid, weight, mean = np.zeros((3, side, side))
    for own, near_m in rounds:
        pull(xy, height, grid, near_m, 0.1, 0.25, weight, mean)
        weight = np.minimum(weight, 2.0)
        grid = grid + smoothed(weight * mean, own) / (smoothed(weight, own) + 0.05)
    np.testing.assert_array_equal(found, (grid, weight))


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_points_on_the_ground(count: int) -> None:
    xyz = points(count, half_m=40)  # beyond the grid, too
    height = xyz[:, 0] * PLANE[0] + xyz[:, 1] * PLANE[1] + xyz[:, 2] * PLANE[2] + PLANE[3]
    np.testing.assert_array_equal(on_plane(xyz, PLANE, np.float32(0.2)), np.abs(height) <= np.float32(0.2))
    relief = Relief(np.array([-20.0, -15.0]), 4.0, surface(4))
    on = on_relief(xyz, PLANE, relief.origin_xy, relief.cell_m, relief.offsets_m, 0.2)
    np.testing.assert_array_equal(on, np.abs(height - relief.offset_m(xyz[:, :2])) <= 0.2)


def test_a_point_is_on_the_plane_by_its_distance() -> None:
    plane = Plane(np.array([0.0, 0.6, 0.8]), 1.0)
    rounded = np.append(plane.normal, plane.offset_m).astype(np.float32)
    xyz = np.array([[5, 0, 0], [0, -1, -0.5], [1, 1, 1]], np.float32)  # 1, 0 and 2.4 above it
    assert on_plane(xyz, rounded, np.float32(1)).tolist() == [True, True, False]
    assert on_plane(xyz, rounded, np.float32(0.5)).tolist() == [False, True, False]
