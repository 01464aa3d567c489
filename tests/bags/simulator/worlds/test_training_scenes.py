from typing import get_args

import numpy as np
import pytest

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, TrainingSweep, sweep
from lidcam.pipeline.core.arrays import I64


def test_a_seed_has_one_sweep() -> None:
    other, one, two = (sweep("sandbox", SWEEPS_PER_WORLD - 1 + row) for row in range(3))
    sweep("sandbox", 9 * SWEEPS_PER_WORLD)  # the first world is forgotten
    again = sweep("sandbox", SWEEPS_PER_WORLD - 1)
    assert other.lidar == again.lidar
    for name in ("points", "centers", "sizes", "yaws", "point_counts", "origin"):
        np.testing.assert_array_equal(getattr(other, name), getattr(again, name))
    assert other.class_names != one.class_names or (other.centers != one.centers).any()  # another world
    np.testing.assert_array_equal(one.centers, two.centers)  # another lidar in the same world
    assert one.lidar != two.lidar


def inside(found: TrainingSweep, margin_m: float) -> I64:
    """(M,) points in each box, which is larger by a margin at each side."""
    off = found.points[:, None, :3].astype(np.float64) - found.centers
    cos, sin = np.cos(found.yaws), np.sin(found.yaws)
    along, left = cos * off[..., 0] + sin * off[..., 1], cos * off[..., 1] - sin * off[..., 0]
    beyond = np.abs(np.stack([along, left, off[..., 2]], 2)) - found.sizes / 2
    return np.asarray((beyond <= margin_m).all(2).sum(0))


@pytest.mark.parametrize("family", get_args(Family))
def test_boxes_hold_the_points_that_are_on_them(family: Family) -> None:
    for seed in (2 * SWEEPS_PER_WORLD, 2 * SWEEPS_PER_WORLD + 1):
        found = sweep(family, seed, exact=True)
        assert found.points.dtype == np.float32
        assert len(found.points) > 5_000
        assert found.point_counts.max() > 100
        assert (inside(found, 3 * found.lidar.range_noise_m) >= 0.9 * found.point_counts).all()
        assert (inside(found, 0.45) >= found.point_counts).all()  # mirrors


def test_points_have_the_mounting_error_of_their_lidar() -> None:
    for seed in (2 * SWEEPS_PER_WORLD, 2 * SWEEPS_PER_WORLD + 1):
        exact, erring = sweep("crossing", seed, exact=True), sweep("crossing", seed)
        off = erring.origin - exact.origin
        np.testing.assert_allclose(np.linalg.norm(off), np.linalg.norm(erring.lidar.miscalibration.xyz_cm) / 100)
        np.testing.assert_allclose(erring.points[:, :3] - exact.points[:, :3] - off, 0, atol=2e-5)
        np.testing.assert_array_equal(erring.centers, exact.centers)


def test_a_car_sees_the_road_below_its_base_frame() -> None:
    found = sweep("road", 2 * SWEEPS_PER_WORLD + 1)
    near = (np.abs(found.points[:, :2]) < (12, 1.2)).all(1)
    assert abs(np.median(found.points[near, 2])) < 0.3
    assert 1.3 < found.origin[2] < 2.9
    assert found.points[:, 3].min() >= 0
    assert found.points[:, 3].max() <= 255
