"""The compiled passes, against numpy."""

import numpy as np
import pytest

from pipeline.core.arrays import F32, F64
from pipeline.core.clouds import Plane, Relief
from pipeline.filters.relief_passes import lowest_of_cells, parted

PLANE = np.array([0.05, -0.1, 0.9937303, 1.2], np.float32)


def points(count: int, *, half_m: float = 25.0) -> F32:
    rng = np.random.default_rng(count)
    x, y = rng.uniform(-half_m, half_m, (2, count))
    xyz = np.column_stack([x, y, -1.2 + 0.3 * rng.random(count)]).astype(np.float32)
    xyz.flags.writeable = False
    return xyz


def surface(seed: int, shape: tuple[int, int] = (9, 12)) -> F64:
    return np.random.default_rng(seed).normal(0, 0.1, shape)


@pytest.mark.parametrize("count", [0, 1, 4000])
def test_lowest_of_cells(count: int) -> None:
    xyz, side = points(count), 30
    middle, origin = np.array([1, -2], np.float32), np.array([-18, -20], np.float32)
    limits = np.float32(0.2), np.float32(0.08), np.float32(0.07)
    columns = np.ascontiguousarray(xyz.T)
    cells, means = lowest_of_cells(columns, PLANE, middle, origin, np.float32(1.5), side, *limits)

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


PLAIN = np.zeros(2), 1.0, np.zeros((0, 0))
"""Of ground that does not differ from its plane."""


@pytest.mark.parametrize("count", [0, 1, 3000])
@pytest.mark.parametrize("distance_m", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("offset_m", [-0.4, 0.0, 0.4])
def test_points_on_the_ground(count: int, distance_m: float, offset_m: float) -> None:
    xyz = points(count, half_m=40)  # beyond the grid, too
    kept = np.random.default_rng(5).random(count) < 0.8
    height = xyz[:, 0] * PLANE[0] + xyz[:, 1] * PLANE[1] + xyz[:, 2] * PLANE[2] + PLANE[3]
    on_plane = np.abs(height) <= np.float32(distance_m)
    relief = Relief(np.array([-20.0, -15.0]), 4.0, surface(4) + offset_m)
    left, level, above = parted(xyz, kept, PLANE, distance_m, relief.origin_xy, relief.cell_m, relief.offsets_m)
    np.testing.assert_array_equal(left, np.flatnonzero(kept & ~on_plane))
    np.testing.assert_array_equal(level, np.flatnonzero(kept & on_plane))
    on_ground = np.abs(height - relief.offset_m(xyz[:, :2])) <= distance_m
    np.testing.assert_array_equal(above, np.flatnonzero(~on_ground))
    np.testing.assert_array_equal(parted(xyz, kept, PLANE, distance_m, *PLAIN)[2], np.flatnonzero(~on_plane))


def test_limits_of_the_relief_belong_to_the_ground() -> None:
    xyz = np.array([[10, 0, 1], [9, 0, -0.5], [5, 0, 0.25], [0, 0, 0], [0, 0, -1.5], [-5, 0, -0.5]], np.float32)
    level, grid = np.array([0, 0, 1, 0], np.float32), np.array([[-1.0, 0.5], [-1.0, 0.5]])  # from x = 0 to 10
    above = parted(xyz, np.ones(6, np.bool_), level, 0.5, np.zeros(2), 10.0, grid)[2]
    assert above.tolist() == [1, 3]


def test_a_point_is_on_the_plane_by_its_distance() -> None:
    plane = Plane(np.array([0.0, 0.6, 0.8]), 1.0)
    rounded = np.append(plane.normal, plane.offset_m).astype(np.float32)
    xyz = np.array([[5, 0, 0], [0, -1, -0.5], [1, 1, 1]], np.float32)  # 1, 0 and 2.4 above it
    for distance_m, on in ((1.0, [0, 1]), (0.5, [1])):
        assert parted(xyz, np.ones(3, np.bool_), rounded, distance_m, *PLAIN)[1].tolist() == on
