"""The compiled passes, against the same with arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.core.arrays import F32
from pipeline.filters import ground_arrays, ground_passes

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
    found = ground_passes.lowest_of_cells(xyz, np.float32(cell_m))
    np.testing.assert_array_equal(found, ground_arrays.lowest_of_cells(xyz, np.float32(cell_m)))


def test_of_equally_low_points_the_first_is_taken_and_far_cells_are_one() -> None:
    xyz = np.array([[5, 1, 5, 1, 1e12, 3e12], [5, 1, 5, 1, 0, 0], [2, 1, 2, 0, 7, 6]], np.float32)
    for passes in (ground_passes, ground_arrays):
        assert passes.lowest_of_cells(xyz, np.float32(3)).tolist() == [3, 0, 5]


@pytest.mark.parametrize("count", [0, 1, 3, 5000])
def test_counts(count: int) -> None:
    rng = np.random.default_rng(1)
    planes = (PLANE + rng.normal(0, 0.01, (7, 4))).astype(np.float32)
    for got, expected in zip(
        ground_passes.count_layers(points(count), planes, LAYER_M),
        ground_arrays.count_layers(points(count), planes, LAYER_M),
        strict=True,
    ):
        np.testing.assert_array_equal(got, expected)


def test_limits_belong_to_the_layers() -> None:
    xyz = np.array([[0, 0, 0, 0, 0, 0, 0, 0]] * 2 + [[-3, -2, -1, -0.5, 0, 1, 2, 3]], np.float32)
    held, beside = ground_passes.count_layers(xyz, np.array([[0, 0, 1, 0]], np.float32), np.float32(1))
    assert (held.tolist(), beside.tolist()) == ([3], [2])
    assert ground_passes.heights_within(xyz, np.array([0, 0, 1, 0], np.float32), np.float32(1)).tolist() == [
        1,
        0.5,
        0,
        1,
    ]


@given(xyz=st.integers(0, 50).flatmap(lambda n: arrays(np.float32, (3, n), elements=st.floats(-2, 2, width=16))))
def test_heights(xyz: F32) -> None:
    np.testing.assert_array_equal(
        ground_passes.heights_within(xyz, PLANE, np.float32(0.7)),
        ground_arrays.heights_within(xyz, PLANE, np.float32(0.7)),
    )


@pytest.mark.parametrize("count", [3, 5000])
def test_scatter(count: int) -> None:
    limit_m = np.float32(0.4)
    centre, scatter = ground_passes.scatter_within(points(count), PLANE, limit_m)
    expected_centre, expected = ground_arrays.scatter_within(points(count), PLANE, limit_m)
    np.testing.assert_allclose(centre, expected_centre, rtol=1e-12)
    np.testing.assert_allclose(scatter, expected, rtol=1e-11, atol=1e-12)
