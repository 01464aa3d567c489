"""The height of the ground at a place: of the plane, and of its relief."""

import numpy as np
import pytest
from lidar_scene import combined
from scipy.interpolate import RegularGridInterpolator

from lidcam.pipeline.core.clouds import Plane, Relief

PLANE = Plane(np.array([0.0, 0.0, 1.0]), -0.5)


def relief() -> Relief:
    return Relief(np.array([-2.0, -1.0]), 0.5, np.random.default_rng(0).normal(0, 0.1, (7, 9)))


def test_between_nodes_it_is_bilinear_and_beyond_the_grid_that_of_its_edge() -> None:
    one = relief()
    x, y = -2.0 + 0.5 * np.arange(9), -1.0 + 0.5 * np.arange(7)
    judge = RegularGridInterpolator((y, x), one.offsets_m)
    xy = np.random.default_rng(1).uniform((-4, -3), (4, 4), (500, 2))
    inside = np.column_stack([np.clip(xy[:, 1], y[0], y[-1]), np.clip(xy[:, 0], x[0], x[-1])])
    np.testing.assert_allclose(one.offset_m(xy), judge(inside), atol=1e-12)
    np.testing.assert_allclose(one.offset_m(xy.reshape(50, 10, 2)), judge(inside).reshape(50, 10), atol=1e-12)


def test_the_ground_is_the_plane_with_its_relief_else_level() -> None:
    one, xy = relief(), np.array([[0.1, 0.2], [1.0, 1.0]])
    cloud = combined(np.zeros((0, 3)))
    assert cloud.ground_m(xy, level_m=-1.7).tolist() == [-1.7, -1.7]
    assert combined(np.zeros((0, 3)), plane=PLANE).ground_m(xy, level_m=-1.7).tolist() == [0.5, 0.5]
    lifted = combined(np.zeros((0, 3)), plane=PLANE, relief=one).ground_m(xy, level_m=-1.7)
    np.testing.assert_allclose(lifted, 0.5 + one.offset_m(xy))


@pytest.mark.parametrize("shape", [(1, 5), (5, 1)])
def test_a_grid_has_two_nodes_each_way(shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="2 x 2"):
        Relief(np.zeros(2), 1.0, np.zeros(shape))
