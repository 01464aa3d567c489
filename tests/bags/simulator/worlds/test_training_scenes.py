import numpy as np
import pytest

from bags.simulator.worlds.draw import FAMILIES, Family
from bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, TrainingSweep, sweep, sweeps


def test_a_seed_has_one_sweep_whatever_the_number_of_processes() -> None:  # their start takes seconds
    seeds = range(SWEEPS_PER_WORLD - 1, SWEEPS_PER_WORLD + 2)
    alone, together = list(sweeps("sandbox", seeds)), list(sweeps("sandbox", seeds, workers=2))
    for one, other in zip(alone, together, strict=True):
        assert one.lidar == other.lidar
        for name in ("points", "object_of_point", "centers", "sizes", "yaws", "point_counts", "origin"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert alone[0].class_names != alone[1].class_names or (alone[0].centers != alone[1].centers).any()  # another world
    np.testing.assert_array_equal(alone[1].centers, alone[2].centers)  # another lidar in the same world
    assert alone[1].lidar != alone[2].lidar
    assert list(sweeps("sandbox", range(0))) == []


def outside_m(found: TrainingSweep) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """How far each point on an object is outside of its box; 0 inside."""
    on = found.object_of_point >= 0
    rows = found.object_of_point[on]
    off = found.points[on, :3].astype(np.float64) - found.centers[rows]
    cos, sin = np.cos(found.yaws[rows]), np.sin(found.yaws[rows])
    along, left = cos * off[:, 0] + sin * off[:, 1], cos * off[:, 1] - sin * off[:, 0]
    beyond = np.abs(np.stack([along, left, off[:, 2]], 1)) - found.sizes[rows] / 2
    return np.asarray(np.maximum(beyond, 0.0).max(1))


@pytest.mark.parametrize("family", FAMILIES)
def test_boxes_hold_the_points_that_are_on_them(family: Family) -> None:
    for seed in (2 * SWEEPS_PER_WORLD, 2 * SWEEPS_PER_WORLD + 1):
        found = sweep(family, seed)
        assert found.points.dtype == np.float32
        assert len(found.points) == len(found.object_of_point) > 5_000
        np.testing.assert_array_equal(
            found.point_counts,
            np.bincount(found.object_of_point[found.object_of_point >= 0], minlength=len(found.yaws)),
        )
        assert found.point_counts.max() > 100
        outside = outside_m(found)
        assert np.quantile(outside, 0.97) < 3 * found.lidar.range_noise_m
        assert outside.max() < 0.45  # mirrors


def test_a_car_sees_the_road_below_its_base_frame() -> None:
    found = sweep("road", 2 * SWEEPS_PER_WORLD + 1)
    near = (np.abs(found.points[:, :2]) < (12, 1.2)).all(1)
    rest = found.points[near & (found.object_of_point < 0), 2]
    assert abs(np.median(rest)) < 0.3
    assert 1.3 < found.origin[2] < 2.9
    assert found.points[:, 3].min() >= 0
    assert found.points[:, 3].max() <= 255
