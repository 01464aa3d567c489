"""The compiled passes, against the same with arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.core.arrays import F32
from pipeline.filters import ground_arrays, ground_passes
from pipeline.filters.ground import GroundPasses

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


@pytest.mark.parametrize("count", [0, 1, 200])
def test_planes(count: int) -> None:
    rng = np.random.default_rng(count)
    xyz = np.column_stack([points(20), [[1, 2, 3]] * 3]).astype(np.float32)  # the last three lie on a line
    triples = rng.integers(23, size=(count, 3))
    triples[:1] = [20, 21, 22]
    planes = ground_passes.planes_through(xyz, triples)
    np.testing.assert_array_equal(planes, ground_arrays.planes_through(xyz, triples))
    distinct = [len({*triple}) == 3 and min(triple) < 20 for triple in triples.tolist()]
    assert len(planes) == sum(distinct)
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1)
    for corner in triples[distinct].T:
        np.testing.assert_allclose((planes[:, :3].T * xyz[:, corner]).sum(0) + planes[:, 3], 0, atol=1e-12)


@pytest.mark.parametrize("passes", [ground_passes, ground_arrays])
def test_planes_that_can_be_ground(passes: GroundPasses) -> None:
    level, tilted = [0.0, 0.0, 1.0, 2.0], [0.6, 0.0, 0.8, 2.0]
    lidars, limits = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, -1.5]]), np.array([0.9, -2.5, 0.5])
    lidars.flags.writeable = False
    planes = np.array([level, tilted, [0, 0, 1, 1.4], [0, 0, 1, 3.1], [0, 0, -1, 2], [1, 0, 0, 5]])
    assert passes.can_be_ground(planes, lidars, limits).tolist() == [True, *[False] * 5]
    anywhere = np.array([0.8, 0.0, np.inf])
    assert passes.can_be_ground(planes, lidars, anywhere).tolist() == [True, True, False, True, False, False]
    assert passes.can_be_ground(planes[:0], lidars, limits).tolist() == []


@pytest.mark.parametrize("count", [3, 5000])
def test_scatter(count: int) -> None:
    limit_m = np.float32(0.4)
    centre, scatter = ground_passes.scatter_within(points(count), PLANE, limit_m)
    expected_centre, expected = ground_arrays.scatter_within(points(count), PLANE, limit_m)
    np.testing.assert_allclose(centre, expected_centre, rtol=1e-12)
    np.testing.assert_allclose(scatter, expected, rtol=1e-11, atol=1e-12)


def same_near(xyz: F32, layer_m: np.float32) -> None:
    count, centre, scatter = ground_passes.scatter_near(xyz, PLANE, layer_m)
    expected_count, expected_centre, expected = ground_arrays.scatter_near(xyz, PLANE, layer_m)
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
        for passes in (ground_passes, ground_arrays):
            count, centre, _ = passes.scatter_near(xyz, level, np.float32(1))
            assert count == len(heights)
            np.testing.assert_allclose(centre[2], np.sort(heights)[:near].mean(dtype=float))
