import numpy as np
import pytest

from lidcam.bags.simulator.sensors.lidar import Side, edge_beams
from lidcam.pipeline.core.arrays import F64, Bools

ELEVATION = np.deg2rad([2.0, -10.0, 10.0])
ORDER = np.array([1, 0, 2])  # of laser ids from the lowest up


def beams(firings: int) -> F64:
    azimuth, elevation = np.deg2rad(np.arange(firings))[:, None], ELEVATION[None]
    across = np.cos(elevation)
    directions = [across * np.cos(azimuth), -across * np.sin(azimuth), np.sin(elevation) + 0 * azimuth]
    return np.stack(directions, -1)


def sides(distance_m: F64, normal: F64 | None = None) -> Bools:
    """Of beams from the origin; where nothing else is said, all surfaces face the sensor."""
    directions = beams(len(distance_m))
    if normal is None:
        normal = np.where(np.isfinite(distance_m)[..., None], -directions, 0.0)
    zeros = np.zeros_like(directions)
    return edge_beams(distance_m, normal, zeros, directions, step_m=0.5, reach_m=80.0, by_elevation=ORDER)


@pytest.mark.parametrize("wall_m", [20.0, np.inf])
def test_neither_flat_ground_nor_the_foot_of_a_wall_is_an_edge(wall_m: float) -> None:
    directions = beams(3)
    with np.errstate(divide="ignore"):
        ground_m = np.where(directions[..., 2] < 0, -2 / directions[..., 2], np.inf)
    across_m = wall_m / directions[..., 0]
    grid = np.minimum(ground_m, across_m)
    normal = np.where((ground_m < across_m)[..., None], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0])
    assert not sides(grid, normal).any()
    # A table, not the ground: behind its end the floor is seen.
    grid[2, 1] = 25.0
    assert sides(grid, normal)[1:, 1].any(1).all()


def test_sides() -> None:
    grid = np.full((2, 3), 10.0)
    grid[0, 1] = 20.0  # the lowest of the first firing
    edges = sides(grid)
    of = {(firing, laser): np.flatnonzero(edges[firing, laser]).tolist() for firing, laser in np.ndindex(2, 3)}
    assert of == {
        (0, 0): [Side.BELOW],
        (0, 1): [Side.AFTER, Side.ABOVE],
        (0, 2): [],
        (1, 0): [],
        (1, 1): [Side.BEFORE],
        (1, 2): [],
    }
