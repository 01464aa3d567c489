"""The compiled passes, against the same by numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lidcam.pipeline.core.arrays import F32
from lidcam.pipeline.core.clouds import Relief
from lidcam.pipeline.filters.ground import PLAIN
from lidcam.pipeline.filters.ground_kernels import COMPILED, parted

PLANE = np.array([0.05, -0.1, 0.9937303, 1.2], np.float32)
LAYER_M = np.float32(0.1)


def points(count: int) -> F32:
    rng = np.random.default_rng(count)
    xyz = rng.uniform(-20, 20, (3, count))
    xyz[2] = -(PLANE[0] * xyz[0] + PLANE[1] * xyz[1] + PLANE[3]) / PLANE[2] + rng.normal(0, 0.1, count)
    return xyz.astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 3, 5000])
@pytest.mark.parametrize("cell_m", [0.01, 1.0, 1e3])
def test_lowest_of_cells(count: int, cell_m: float) -> None:
    xyz = points(count)
    found = COMPILED.lowest_of_cells(xyz, np.float32(cell_m))
    np.testing.assert_array_equal(found, PLAIN.lowest_of_cells(xyz, np.float32(cell_m)))


def test_of_equally_low_points_the_first_is_taken_and_far_cells_are_one() -> None:
    xyz = np.array([[5, 1, 5, 1, 1e12, 3e12], [5, 1, 5, 1, 0, 0], [2, 1, 2, 0, 7, 6]], np.float32)
    for passes in (COMPILED, PLAIN):
        assert passes.lowest_of_cells(xyz, np.float32(3)).tolist() == [3, 0, 5]


@pytest.mark.parametrize("count", [0, 1, 3, 5000])
def test_counts(count: int) -> None:
    rng = np.random.default_rng(1)
    planes = (PLANE + rng.normal(0, 0.01, (7, 4))).astype(np.float32)
    for got, expected in zip(
        COMPILED.count_layers(points(count), planes, LAYER_M),
        PLAIN.count_layers(points(count), planes, LAYER_M),
        strict=True,
    ):
        np.testing.assert_array_equal(got, expected)


def test_limits_belong_to_the_layers() -> None:
    xyz = np.array([[0, 0, 0, 0, 0, 0, 0, 0]] * 2 + [[-3, -2, -1, -0.5, 0, 1, 2, 3]], np.float32)
    held, beside = COMPILED.count_layers(xyz, np.array([[0, 0, 1, 0]], np.float32), np.float32(1))
    assert (held.tolist(), beside.tolist()) == ([3], [2])


@pytest.mark.parametrize("count", [3, 5000])
def test_scatter(count: int) -> None:
    limit_m = np.float32(0.4)
    centre, scatter = COMPILED.scatter_within(points(count), PLANE, limit_m)
    expected_centre, expected = PLAIN.scatter_within(points(count), PLANE, limit_m)
    np.testing.assert_allclose(centre, expected_centre, rtol=1e-12)
    np.testing.assert_allclose(scatter, expected, rtol=1e-11, atol=1e-12)


def same_near(xyz: F32, layer_m: np.float32) -> None:
    count, centre, scatter = COMPILED.scatter_near(xyz, PLANE, layer_m)
    expected_count, expected_centre, expected = PLAIN.scatter_near(xyz, PLANE, layer_m)
    assert count == expected_count
    np.testing.assert_allclose(centre, expected_centre, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scatter, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5000])
@pytest.mark.parametrize("layer_m", [0.05, 1.0, 100.0])
def test_near_the_plane(count: int, layer_m: float) -> None:
    xyz = points(count)
    xyz[2, ::5] += 30  # far from it, but within the layer if that is thick
    same_near(xyz, np.float32(layer_m))


@given(xyz=st.integers(0, 50).flatmap(lambda n: arrays(np.float32, (3, n), elements=st.floats(-2, 2, width=16))))
def test_near_the_plane_if_many_are_equally_far(xyz: F32) -> None:
    same_near(xyz, np.float32(0.7))


def test_a_median_is_one_of_the_points_or_between_two() -> None:
    # Heights 0, 0.01, 0.5 and one, two or three more: only up to three deviations are near.
    level = np.array([0, 0, 1, 0], np.float32)
    for more, near in (([], 2), ([0.02], 3), ([0.02, 0.03], 4), ([0.4, 0.5], 5)):
        heights = np.array([0, 0.01, 0.5, *more], np.float32)
        xyz = np.array([np.arange(len(heights)), 0 * heights, heights], np.float32)
        for passes in (COMPILED, PLAIN):
            count, centre, _ = passes.scatter_near(xyz, level, np.float32(1))
            assert count == len(heights)
            np.testing.assert_allclose(centre[2], np.sort(heights)[:near].mean(dtype=float))


# --- which points belong to the ground


LEVEL = np.zeros(2), 1.0, np.zeros((0, 0))
"""Of ground that does not differ from its plane."""


@pytest.mark.parametrize("count", [0, 1, 3000])
@pytest.mark.parametrize("distance_m", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("offset_m", [-0.4, 0.0, 0.4])
def test_points_on_the_ground(count: int, distance_m: float, offset_m: float) -> None:
    xyz = np.ascontiguousarray(points(count).T) * np.float32(2)  # beyond the grid, too
    kept = np.random.default_rng(5).random(count) < 0.8
    height = xyz[:, 0] * PLANE[0] + xyz[:, 1] * PLANE[1] + xyz[:, 2] * PLANE[2] + PLANE[3]
    on_plane = np.abs(height) <= np.float32(distance_m)
    relief = Relief(np.array([-20.0, -15.0]), 4.0, np.random.default_rng(4).normal(0, 0.1, (9, 12)) + offset_m)
    left, level, above = parted(xyz, kept, PLANE, distance_m, relief.origin_xy, relief.cell_m, relief.offsets_m)
    np.testing.assert_array_equal(left, np.flatnonzero(kept & ~on_plane))
    np.testing.assert_array_equal(level, np.flatnonzero(kept & on_plane))
    on_ground = np.abs(height - relief.offset_m(xyz[:, :2])) <= distance_m
    np.testing.assert_array_equal(above, np.flatnonzero(~on_ground))
    np.testing.assert_array_equal(parted(xyz, kept, PLANE, distance_m, *LEVEL)[2], np.flatnonzero(~on_plane))


def test_limits_of_the_relief_belong_to_the_ground() -> None:
    xyz = np.array([[10, 0, 1], [9, 0, -0.5], [5, 0, 0.25], [0, 0, 0], [0, 0, -1.5], [-5, 0, -0.5]], np.float32)
    flat, grid = np.array([0, 0, 1, 0], np.float32), np.array([[-1.0, 0.5], [-1.0, 0.5]])  # from x = 0 to 10
    above = parted(xyz, np.ones(6, np.bool_), flat, 0.5, np.zeros(2), 10.0, grid)[2]
    assert above.tolist() == [1, 3]
