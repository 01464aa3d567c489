"""The passes over all points, against the same by numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import Relief
from lidcam.pipeline.native import kernels

PLANE = np.array([0.05, -0.1, 0.9937303, 1.2], np.float32)


def points(count: int) -> F32:
    rng = np.random.default_rng(count)
    xyz = rng.uniform(-20, 20, (3, count))
    xyz[2] = -(PLANE[0] * xyz[0] + PLANE[1] * xyz[1] + PLANE[3]) / PLANE[2] + rng.normal(0, 0.1, count)
    return xyz.astype(np.float32)


def heights_of(xyz: F32, plane: F32) -> F32:
    heights: F32 = xyz[0] * plane[0] + xyz[1] * plane[1] + xyz[2] * plane[2] + plane[3]
    return heights


@pytest.mark.parametrize("count", [0, 1, 3, 5000])
def test_counts(count: int) -> None:
    xyz, rng = points(count), np.random.default_rng(1)
    planes = (PLANE + rng.normal(0, 0.01, (7, 4))).astype(np.float32)
    for held, beside, plane in zip(*kernels.count_layers(xyz, planes, 0.1), planes, strict=True):
        heights = heights_of(xyz, plane)
        below, within, above = np.diff([(heights <= np.float32(k) * np.float32(0.1)).sum() for k in (-3, -1, 1, 3)])
        assert (held, beside) == (within, max(below, above))


def is_scatter(centre: F64, scatter: F64, near: F32) -> None:
    np.testing.assert_allclose(centre, near.mean(axis=1, dtype=float), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(scatter, np.cov(near, bias=True, dtype=float), rtol=1e-11, atol=1e-12)


def same_near(xyz: F32, layer_m: float) -> None:
    count, centre, scatter = kernels.scatter_near(xyz, PLANE, layer_m)
    heights = np.abs(heights_of(xyz, PLANE))
    within = heights[heights <= np.float32(layer_m)]
    assert count == len(within)
    if count:
        near_m = min(np.float32(layer_m), np.float32(3 * 1.4826 * float(np.median(within)) + 1e-6))
        is_scatter(centre, scatter, xyz[:, heights <= near_m])
    else:
        assert not np.append(centre, scatter).any()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5000])
@pytest.mark.parametrize("layer_m", [0.05, 1.0, 100.0])
def test_near_the_plane(count: int, layer_m: float) -> None:
    xyz = points(count)
    xyz[2, ::5] += 30  # far from it, but within the layer if that is thick
    same_near(xyz, layer_m)


@given(xyz=st.integers(0, 50).flatmap(lambda n: arrays(np.float32, (3, n), elements=st.floats(-2, 2, width=16))))
def test_near_the_plane_if_many_are_equally_far(xyz: F32) -> None:
    same_near(xyz, 0.7)


# --- which points belong to the ground


@pytest.mark.parametrize("count", [0, 1, 3000])
@pytest.mark.parametrize("distance_m", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("offset_m", [-0.4, 0.0, 0.4])
def test_points_on_the_ground(count: int, distance_m: float, offset_m: float) -> None:
    xyz = np.ascontiguousarray(points(count).T) * np.float32(2)  # beyond the grid, too
    kept = np.random.default_rng(5).random(count) < 0.8
    height = xyz[:, 0] * PLANE[0] + xyz[:, 1] * PLANE[1] + xyz[:, 2] * PLANE[2] + PLANE[3]
    on_plane = np.abs(height) <= np.float32(distance_m)
    relief = Relief(np.array([-20.0, -15.0]), 4.0, np.random.default_rng(4).normal(0, 0.1, (9, 12)) + offset_m)
    left, level, above = kernels.parted(xyz, kept, PLANE, distance_m, relief.origin_xy, relief.cell_m, relief.offsets_m)
    np.testing.assert_array_equal(left, np.flatnonzero(kept & ~on_plane))
    np.testing.assert_array_equal(level, np.flatnonzero(kept & on_plane))
    on_ground = np.abs(height - relief.offset_m(xyz[:, :2])) <= distance_m
    np.testing.assert_array_equal(above, np.flatnonzero(~on_ground))
