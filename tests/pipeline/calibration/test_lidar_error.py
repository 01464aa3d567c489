"""A lidar that stands elsewhere than its calibration says is found by the walls and the floor that both lidars see."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidcam.pipeline.calibration.lidar_error import lidar_error
from lidcam.pipeline.core.arrays import F64

FIRST, SECOND = np.array([-2.0, 0, 1.8]), np.array([2.0, 1, 1.6])
ROOM = np.array([[-10.0, -8, 0], [10, 8, 5]])


def seen(origin: F64, seed: int, *, floor_only: bool = False) -> F64:
    """(N, 3) points of a lidar of 32 beams on the inner sides of a room, with 1 cm of noise."""
    random = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(np.arange(0.001, 2 * np.pi, 0.01), np.radians(np.linspace(-25, 10.5, 32)))
    rays = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)
    rays = rays.reshape(-1, 3)
    ranges = np.where(rays > 0, ROOM[1] - origin, ROOM[0] - origin) / rays
    nearest = ranges.argmin(1)
    points = origin + rays * (ranges.min(1) + random.normal(0, 0.01, len(rays)))[:, None]
    return np.asarray(points[(nearest == 2) & (rays[:, 2] < 0)] if floor_only else points)


def placed(points: F64, values: F64) -> F64:
    """The points of the second lidar by a calibration that has this error."""
    return np.asarray((points - SECOND - values[3:]) @ Rotation.from_rotvec(values[:3]).as_matrix() + SECOND)


@pytest.mark.parametrize(
    "values",
    [(0, 0, 0, 0, 0, 0), (0, 0, 0, 0.05, 0, 0), (0.005, -0.01, 0.015, -0.05, 0.03, 0.04)],
    ids=["none", "5 cm", "all"],
)
def test_the_error_is_found(values: tuple[float, ...]) -> None:
    given = np.array(values)
    found = lidar_error([(seen(FIRST, 1), placed(seen(SECOND, 2), given))], SECOND)
    assert found is not None
    assert (np.abs(found.values - given) < 4 * found.sigmas).all()
    assert np.abs(found.values - given)[3:].max() < 0.02
    assert found.sigmas[3:].max() < 0.02


def test_a_floor_says_nothing_of_the_way_along_it() -> None:
    given = np.array([0, 0, 0, 0.1, 0.1, 0.05])
    floors = seen(FIRST, 1, floor_only=True), placed(seen(SECOND, 2, floor_only=True), given)
    found = lidar_error([floors], SECOND)
    assert found is not None
    assert abs(found.values[5] - 0.05) < 0.02
    assert found.sigmas[3:5].min() > 0.1  # what is known before
    assert found.sigmas[5] < 0.02


@pytest.mark.parametrize(
    "frames",
    [
        [],
        [(np.zeros((0, 3)), np.zeros((0, 3)))],
        [(seen(FIRST, 1)[:10], seen(SECOND, 2))],
        [(seen(FIRST, 1), seen(SECOND, 2)[:50])],
        [(seen(FIRST, 1), seen(SECOND, 2) + 100)],
    ],
    ids=["no frames", "empty", "few points of the one", "few of the other", "nothing in common"],
)
def test_too_little_in_common_is_not_judged(frames: list[tuple[F64, F64]]) -> None:
    assert lidar_error(frames, SECOND) is None
