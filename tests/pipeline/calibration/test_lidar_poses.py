"""Lidars that disagree are moved until they agree: the one that is far off, or all by a little."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seen_rooms import FIRST, SECOND, placed, seen

from lidcam.pipeline.calibration.lidar_error import LidarError
from lidcam.pipeline.calibration.lidar_poses import LidarPair, agreeing_motions, compared_lidars, moved_lidar
from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor

PLACES = np.array([FIRST, SECOND, [0.0, -4.0, 2.0], [8.0, 3.0, 1.0]])
PRECISE = np.diag([1e-5] * 3 + [1e-4] * 3) ** 2


def lidar(name: str, place: F64) -> LidarSensor:
    return LidarSensor(name, f"/{name}", Transform.from_quaternion("site", name, tuple(place), (0, 0, 0, 1)))


LIDARS = [lidar(f"lidar{number}", place) for number, place in enumerate(PLACES)]


def between(first: int, second: int, errors: F64) -> LidarPair:
    """Two lidars and what `lidar_error` finds between them, where `errors` (L, 6) bring each lidar to its place."""
    arm = PLACES[second] - PLACES[first]
    carried = [*errors[first, :3], *(errors[first, 3:] + np.cross(errors[first, :3], arm))]
    return LidarPair(LIDARS[first], LIDARS[second], LidarError(errors[second] - carried, PRECISE, 1000))


def all_pairs(errors: F64, count: int) -> list[LidarPair]:
    return [between(first, second, errors) for first in range(count) for second in range(first + 1, count)]


vectors = st.lists(st.floats(-0.02, 0.02), min_size=24, max_size=24).map(lambda row: np.reshape(row, (4, 6)))


@given(vectors, st.integers(2, 4))
def test_lidars_agree_afterwards(errors: F64, count: int) -> None:
    motions = np.zeros((4, 6))
    motions[:count] = agreeing_motions(LIDARS[:count], "site", all_pairs(errors, count))
    for pair in all_pairs(errors - motions, count):
        assert pair.error is not None
        np.testing.assert_allclose(pair.error.values, 0, atol=1e-4)


@pytest.mark.parametrize(
    ("count", "error", "shares"),
    [
        (2, 0.04, (-0.5, 0.5)),
        (2, 0.5, (0, 1)),
        (3, 0.03, (-1 / 3, 2 / 3, -1 / 3)),
        (3, 0.5, (0, 1, 0)),
        (4, 0.5, (0, 1, 0, 0)),
    ],
)
def test_small_errors_are_shared_and_large_ones_are_not(count: int, error: float, shares: tuple[float, ...]) -> None:
    errors = np.zeros((4, 6))
    errors[1, 3] = error
    motions = agreeing_motions(LIDARS[:count], "site", all_pairs(errors, count))
    np.testing.assert_allclose(motions[:, 3], np.multiply(shares, error), atol=0.1 * error)


def test_a_lidar_whose_frame_is_the_site_stays() -> None:
    errors = np.zeros((4, 6))
    errors[0, 2], errors[1, 3] = 0.02, 0.05
    motions = agreeing_motions(LIDARS[:3], "lidar1", all_pairs(errors, 3))
    np.testing.assert_allclose(motions[1], 0, atol=1e-6)
    np.testing.assert_allclose(motions[0, :3], errors[0, :3], atol=1e-4)
    of_site = [replace(one, T_site_lidar=replace(one.T_site_lidar, src="site")) for one in LIDARS[:3]]
    assert np.abs(agreeing_motions(of_site, "site", all_pairs(errors, 3))).max() > 0.01  # all clouds are given in it


def test_a_lidar_that_none_can_judge_stays() -> None:
    errors = np.zeros((4, 6))
    errors[1, 3] = 0.04
    pairs = [*all_pairs(errors, 2), LidarPair(LIDARS[0], LIDARS[2], None)]
    motions = agreeing_motions(LIDARS[:3], "site", pairs)
    np.testing.assert_array_equal(motions[2], 0)
    assert (agreeing_motions(LIDARS[:3], "site", []) == 0).all()


def test_a_moved_lidar_turns_about_itself() -> None:
    values = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    moved = moved_lidar(LIDARS[1], values)
    np.testing.assert_allclose(moved.T_site_lidar.translation, SECOND + values[3:])
    np.testing.assert_allclose(moved.T_site_lidar.matrix[:3, :3], motion(values)[:3, :3])


def room(second: F64, seed: int = 0) -> list[F64]:
    return [seen(FIRST, seed + 1), placed(seen(SECOND, seed + 2), second)]


def test_what_they_see_is_compared() -> None:
    given_error = np.array([0, 0, 0.02, 0.2, 0, 0])
    clouds = [room(given_error), room(given_error, 10)]
    compared = compared_lidars(LIDARS[:2], "lidar0", clouds)
    [pair] = compared.pairs
    assert pair.error is not None
    np.testing.assert_array_equal(pair.error.large, [False, False, True, True, False, False])
    assert not pair.is_first_off
    assert compared_lidars(LIDARS[:2], "lidar1", clouds).pairs[0].is_first_off  # the one that moves is wrong
    first, second = compared.agreeing
    np.testing.assert_allclose(first.T_site_lidar.matrix, LIDARS[0].T_site_lidar.matrix, atol=1e-6)
    np.testing.assert_allclose(second.T_site_lidar.translation, SECOND + given_error[3:], atol=0.02)


@pytest.mark.parametrize(
    ("clouds", "is_judged"),
    [
        ([], False),
        ([[np.zeros((0, 3))] * 2], False),
        ([room(np.zeros(6))], True),
        ([room(np.zeros(6)), *[room(np.array([0, 0, 0, 0.08, 0, 0]))] * 3], False),
    ],
    ids=["none", "empty", "sound", "comes and goes"],
)
def test_nothing_is_moved_without_an_error_that_stays(clouds: list[list[F64]], *, is_judged: bool) -> None:
    compared = compared_lidars(LIDARS[:2], "site", clouds)
    assert compared.agreeing == ()
    assert [pair.error is not None for pair in compared.pairs] == [is_judged]
    assert compared_lidars(LIDARS[:1], "site", [cloud[:1] for cloud in clouds]) == ((), ())
