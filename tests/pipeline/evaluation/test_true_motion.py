"""Motion of true objects over the ground, against motions that are known in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN
from lidcam.pipeline.evaluation.true_motion import ground_poses, ground_turns, has_moved, true_velocities

STEP_NS = 100_000_000


def site_pose(yaw: float, x: float, y: float) -> F64:
    return pose_matrix(Rotation.from_euler("z", yaw).as_matrix(), (x, y, 0.0))


def velocities(frames: list[int], poses: list[tuple[float, ...]], tracks: list[int], stamps_ns: list[int]) -> F64:
    return true_velocities(
        np.array(frames, np.int32),
        np.array(stamps_ns, np.int64),
        np.zeros(len(frames), np.int32),
        np.array(tracks, np.int64),
        np.array(poses, np.float64).reshape(-1, 3),
    )


def test_an_object_seen_from_a_site_that_drives_and_turns() -> None:
    """On a circle of 20 m at 0.5 rad/s; the site goes its own way, and the places over the ground are those."""
    times = np.arange(40) * 0.1
    true = np.column_stack([20 * np.sin(0.5 * times), 20 - 20 * np.cos(0.5 * times), 0.5 * times + 3])
    sites = [site_pose(0.3 * t, 8 * t, t * t) for t in times.tolist()]
    inverse = np.linalg.inv(sites)
    centers = np.einsum("nij,nj->ni", inverse, np.column_stack([true[:, :2], np.full(40, 0.7), np.ones(40)]))[:, :3]
    yaws = true[:, 2] - 0.3 * times
    frames = np.arange(7, 47, dtype=np.int32)
    poses = ground_poses(centers, yaws, np.array(sites))
    assert_allclose(poses, true, atol=1e-9)
    stamps_ns = np.arange(47) * STEP_NS
    found = true_velocities(frames, stamps_ns, np.zeros(40, np.int32), np.full(40, 3, np.int64), poses)
    assert_allclose(found[1:-1, 0], 10 * np.cos(0.5 * times[1:-1]), atol=0.01)
    assert_allclose(found[1:-1, 1], 10 * np.sin(0.5 * times[1:-1]), atol=0.01)
    assert_allclose(found[1:-1, 2], 0.5, atol=1e-6)
    assert np.isnan(found[[0, -1]]).all()
    in_site = np.einsum("nji,nj->ni", np.array(sites)[:, :2, :2], found[:, :2])
    assert_allclose(ground_turns(in_site, np.array(sites)), found[:, :2], atol=1e-9)


def test_where_the_site_is_not_known_nothing_is() -> None:
    poses = ground_poses(np.ones((2, 3)), np.zeros(2), np.array([np.full((4, 4), np.nan), np.eye(4)]))
    assert np.isnan(poses[0]).all()
    assert_array_equal(poses[1], [1, 1, 0])
    assert len(ground_poses(np.ones((0, 3)), np.zeros(0), np.ones((0, 4, 4)))) == 0


def test_headings_go_on_through_half_a_turn() -> None:
    found = velocities([0, 1, 2], [(0, 0, 3.1), (0, 0, np.pi), (0, 0, -3.1)], [1] * 3, [0, STEP_NS, 2 * STEP_NS])
    assert found[1, 2] == pytest.approx((2 * np.pi - 6.2) / 0.2)


@pytest.mark.parametrize(
    ("frames", "tracks", "stamps_ns"),
    [
        ([], [], []),
        ([0], [1], [0]),
        ([0, 1], [1, 1], [0, STEP_NS]),
        ([0, 1, 3], [1, 1, 1], [0, 1, 2, 3]),
        ([0, 1, 2], [1, 2, 1], [0, STEP_NS, 2 * STEP_NS]),
        ([0, 1, 2], [UNKNOWN] * 3, [0, STEP_NS, 2 * STEP_NS]),
        ([0, 1, 2], [1, 1, 1], [0, 10 * STEP_NS, 20 * STEP_NS]),
        ([0, 1, 2], [1, 1, 1], [STEP_NS, 0, STEP_NS]),
        ([0, 0, 1], [1, 1, 1], [0, STEP_NS]),
    ],
    ids=["none", "one", "two", "a gap", "another track", "no track", "too long", "no time passes", "doubled"],
)
def test_what_has_no_velocity(frames: list[int], tracks: list[int], stamps_ns: list[int]) -> None:
    assert np.isnan(velocities(frames, [(0, 0, 0)] * len(frames), tracks, stamps_ns)).all()


def test_what_moves() -> None:
    """Class 0 is 4 m long, class 1 is 1 m; of track 5 both have one, and the place of one row is not known."""
    rows = [
        # class, track, x, y, moves
        (0, 5, 0.0, 0.0, False),
        (1, 5, 0.0, 0.0, True),
        (0, 5, 2.8, 2.8, False),
        (1, 5, 0.8, 0.8, True),
        (0, 6, 0.0, 9.0, True),
        (0, 6, 3.0, 12.0, True),
        (0, 6, np.nan, 0.0, False),
        (0, UNKNOWN, 0.0, 0.0, False),
        (0, UNKNOWN, 99.0, 0.0, False),
        (UNKNOWN, 7, 0.0, 0.0, False),
    ]
    for some in (rows, rows[:1], [], rows[::-1]):
        table = np.array(some, np.float64).reshape(-1, 5)
        poses = np.column_stack([table[:, 2:4], np.zeros(len(table))])
        moves = has_moved(table[:, 0].astype(np.int32), table[:, 1].astype(np.int64), poses, np.array([4.0, 1.0]))
        assert_array_equal(moves, table[:, 4] == 1)
