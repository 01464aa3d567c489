"""A lidar that stands elsewhere than its calibration says is found by the walls and the floor that both lidars see."""

from unittest.mock import patch

import numpy as np
import pytest
from seen_rooms import FIRST, SECOND, placed, seen

from lidcam.pipeline.calibration.lidar_error import TRIES, lidar_error
from lidcam.pipeline.core.arrays import F64


@pytest.mark.parametrize(
    "values",
    [(0, 0, 0, 0, 0, 0), (0, 0, 0, 0.05, 0, 0), (0.005, -0.01, 0.015, -0.05, 0.03, 0.04)],
    ids=["none", "5 cm", "all"],
)
def test_the_error_is_found(values: tuple[float, ...]) -> None:
    given = np.array(values)
    found = lidar_error([(seen(FIRST, 1), placed(seen(SECOND, 2), given))], FIRST, SECOND)
    assert found is not None
    assert (np.abs(found.values - given) < 4 * found.sigmas).all()
    assert np.abs(found.values - given)[3:].max() < 0.02
    assert found.sigmas[3:].max() < 0.02


def test_lidars_of_few_points_are_judged_by_smaller_planes() -> None:
    given = np.array([0, 0, 0.02, 0.1, 0, 0])
    frames = [(seen(FIRST, number)[::9], placed(seen(SECOND, number + 9), given)[::7]) for number in range(3)]
    with patch("lidcam.pipeline.calibration.lidar_error.TRIES", TRIES[:1]):
        assert lidar_error(frames, FIRST, SECOND) is None
    found = lidar_error(frames, FIRST, SECOND)
    assert found is not None
    assert (np.abs(found.values - given) < 4 * found.sigmas).all()
    assert found.significant.tolist() == [False, False, True, True, False, False]


@pytest.mark.parametrize("beams", [8, 12, 16])
def test_points_of_one_ring_are_no_plane(beams: int) -> None:
    """Range noise spreads them along their beams; planes that hold the beams moved sound lidars by 0.6 m."""
    first, second = (
        [seen(place, number, beams=beams, step_rad=0.0035, noise_m=0.02) for number in range(3)]
        for place in (FIRST, SECOND)
    )
    found = lidar_error([*zip(first, second, strict=True)], FIRST, SECOND)
    assert found is None or not found.significant.any()


def test_few_common_planes_are_no_better_known_than_they_scatter() -> None:
    clouds = [
        [seen(place, number, beams=16, step_rad=0.0035, noise_m=0.03) for number in range(12)]
        for place in (FIRST, SECOND)
    ]
    found = [lidar_error([pair], FIRST, SECOND) for pair in zip(*clouds, strict=True)]
    ratios = np.array([one.values / one.sigmas for one in found if one is not None])
    assert len(ratios) == len(found)
    assert np.sqrt((ratios**2).mean(0)).max() < 2.5


def test_a_floor_says_nothing_of_the_way_along_it() -> None:
    given = np.array([0, 0, 0, 0.1, 0.1, 0.05])
    floors = seen(FIRST, 1, floor_only=True), placed(seen(SECOND, 2, floor_only=True), given)
    found = lidar_error([floors], FIRST, SECOND)
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
    assert lidar_error(frames, FIRST, SECOND) is None
