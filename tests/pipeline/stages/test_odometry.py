"""Worlds of walls, posts and ground, scanned anew in each frame from where the rig truly is."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from lidar_scene import combined
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.pose_samples import OdometryPose
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.stages.odometry import FindOdometry

PERIOD_NS = 100_000_000
START_NS = 1_600_000_000_000_000_000

# Corner, and the two edges of each rectangle: two rows of houses with gaps, their ends, posts, and the ground.
HOUSES = [((x, y, -1.7), (9.0, 0, 0), (0, 0, 6.0)) for x in (-30, -18, -6, 6, 18, 30, 42) for y in (-9.0, 11.0)]
ENDS = [((x, y, -1.7), (0, side * 6.0, 0), (0, 0, 6.0)) for (x, y, _), _, _ in HOUSES for side in (np.sign(y),)]
POSTS = [((x, y, -1.7), (0.3, 0.3, 0), (0, 0, 4.0)) for x in range(-28, 50, 11) for y in (-5.0, 6.0)]
GROUND = [((-40.0, -9.0, -1.7), (100.0, 0, 0), (0, 20.0, 0))]
WORLD = np.array(HOUSES + ENDS + POSTS + GROUND)


def on_surfaces(rectangles: F64, density: float, random: np.random.Generator) -> F64:
    """Points all over rectangles, `density` a square metre, 1 cm off."""
    areas = np.linalg.norm(np.cross(rectangles[:, 1], rectangles[:, 2]), axis=1)
    rows = np.repeat(np.arange(len(rectangles)), (areas * density).astype(int))
    corner, one, other = rectangles[rows].transpose(1, 0, 2)
    shares = random.random((2, len(rows), 1))
    return np.asarray(corner + one * shares[0] + other * shares[1] + random.normal(0, 0.01, corner.shape))


def at(x: float, y: float = 0.0, yaw_deg: float = 0.0) -> F64:
    return pose_matrix(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), (x, y, 0.0))


def seen(T_world_site: F64, world: F64 = WORLD, *, seed: int = 0, more: F64 | None = None, scale: float = 1.0) -> F64:
    """What lies within 30 m of the rig, in its frame; `more` are points of the world."""
    points = on_surfaces(world, 3.0, np.random.default_rng(seed))
    points = points if more is None else np.concatenate([points, more])
    site = (points - T_world_site[:3, 3]) @ T_world_site[:3, :3]
    return np.asarray(site[np.linalg.norm(site, axis=1) < 30] * scale)


def found(clouds: Sequence[F64], stamps_ns: Sequence[int] | None = None) -> list[OdometryPose | None]:
    find = FindOdometry()
    times = stamps_ns or [START_NS + i * PERIOD_NS for i in range(len(clouds))]
    return [find(combined(cloud), stamp_ns) for cloud, stamp_ns in zip(clouds, times, strict=True)]


def corrected(clouds: Sequence[F64], recorded: Sequence[F64]) -> list[OdometryPose | None]:
    find = FindOdometry()
    together = zip(clouds, recorded, strict=True)
    return [find(combined(cloud), START_NS + i * PERIOD_NS, T) for i, (cloud, T) in enumerate(together)]


def errors_m(poses: Sequence[OdometryPose | None], truth: Sequence[F64], scale: float = 1.0) -> F64:
    """Distance from the truth by frame; no pose is that of the first frame."""
    first = np.linalg.inv(truth[0])
    there = [np.eye(4) if pose is None else pose.T_fixed_site for pose in poses]
    return np.array(
        [np.linalg.norm(T[:3, 3] - scale * (first @ true)[:3, 3]) for T, true in zip(there, truth, strict=True)]
    )


def straight(i: int) -> F64:
    return at(1.1 * i)


def turning(i: int) -> F64:
    angle = np.radians(4.0 * i)
    return at(12 * np.sin(angle), 12 * (1 - np.cos(angle)) - 4, 4.0 * i)


def turning_in_place(i: int) -> F64:
    return at(0.0, 0.0, 6.0 * i)


@pytest.mark.parametrize(
    ("course", "scale"), [(straight, 1.0), (turning, 1.0), (turning_in_place, 1.0), (turning, 1 / 14)]
)
def test_a_moving_rig_is_followed(course: Callable[[int], F64], scale: float) -> None:
    truth = [course(i) for i in range(12)]
    poses = found([seen(T, seed=i, scale=scale) for i, T in enumerate(truth)])
    assert poses[0] is None
    assert all(pose is not None and not pose.is_predicted for pose in poses[2:])
    assert (errors_m(poses, truth, scale)[2:] < 0.1 * scale).all()
    last = poses[-1]
    assert last is not None
    true = np.linalg.inv(truth[0]) @ truth[-1]
    turned = Rotation.from_matrix(last.T_fixed_site[:3, :3]).inv() * Rotation.from_matrix(true[:3, :3])
    assert np.degrees(turned.magnitude()) < 0.5


def test_a_standing_rig_stands_though_half_of_what_it_sees_moves() -> None:
    random = np.random.default_rng(7)
    clouds = []
    for i in range(25):
        trucks = [((-25.0 + 1.2 * i + 14 * k, 2.5, -1.7), (12.0, 0, 0), (0, 0, 4.0)) for k in range(-2, 3)]
        clouds.append(seen(at(0.0), seed=i, more=on_surfaces(np.array(trucks), 14.0, random)))
    assert found(clouds) == [None] * len(clouds)


def test_a_rig_that_drives_off_after_a_while_is_noticed() -> None:
    truth = [at(0.0)] * 24 + [at(0.5 * i) for i in range(1, 16)]
    poses = found([seen(T, seed=i) for i, T in enumerate(truth)])
    assert poses[:24] == [None] * 24
    assert poses[-1] is not None
    assert errors_m(poses, truth)[-1] < 0.15


@pytest.mark.parametrize("lost", [np.zeros((0, 3)), seen(at(0.0), WORLD[-1:])], ids=["empty", "bare ground"])
def test_what_cannot_be_registered_is_said_and_carried_on_at_the_last_velocity(lost: F64) -> None:
    truth = [straight(i) for i in range(14)]
    clouds = [lost if 6 <= i < 9 else seen(T, seed=i) for i, T in enumerate(truth)]
    poses = found(clouds)
    assert [i for i, pose in enumerate(poses) if pose is not None and pose.is_predicted][:3] == [6, 7, 8]
    assert (errors_m(poses, truth)[2:9] < 0.3).all()


@pytest.mark.parametrize(
    "cloud", [np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((500, 3)), seen(at(0.0), WORLD[-1:])],
    ids=["empty", "one point", "one place", "bare ground"],
)  # fmt: skip
def test_without_shape_nothing_moves(cloud: F64) -> None:
    assert found([cloud] * 12) == [None] * 12


def test_time_may_jump() -> None:
    truth = [straight(i) for i in range(10)]
    stamps_ns = [START_NS + i * PERIOD_NS - (10**10 if i >= 6 else 0) for i in range(10)]
    poses = found([seen(T, seed=i) for i, T in enumerate(truth)], stamps_ns)
    assert (errors_m(poses, truth)[2:] < 0.1).all()


@pytest.mark.parametrize(
    ("course", "off_deg", "most_m"),
    [(straight, 1.5, 0.1), (turning, 0.0, 0.04), (turning, 1.5, 0.1), (turning_in_place, 1.5, 0.1)],
)
def test_recorded_motion_is_corrected(course: Callable[[int], F64], off_deg: float, most_m: float) -> None:
    truth = [course(i) for i in range(24)]
    recorded = [T @ at(0.0, 0.0, off_deg) for T in truth]  # the heading is wrong, the way is not
    poses = corrected([seen(T, seed=i) for i, T in enumerate(truth)], recorded)
    assert poses[0] is None
    first = recorded[0]
    moved = [
        None if pose is None else replace(pose, T_fixed_site=np.linalg.inv(first) @ pose.T_fixed_site) for pose in poses
    ]
    assert (errors_m(moved, truth) < most_m).all()


def test_between_plain_walls_the_pattern_of_the_beams_is_no_error_of_recorded_motion() -> None:
    walls = np.array([((-40.0, y, -1.7), (80.0, 0, 0), (0, 0, 6.0)) for y in (-9.0, 11.0)] + GROUND)
    pattern = seen(at(0.0), walls)  # the same wherever the rig is
    recorded = [at(0.2 * i) for i in range(16)]
    clouds = [np.concatenate([pattern, seen(T, np.array(POSTS), seed=i)]) for i, T in enumerate(recorded)]
    assert (errors_m(corrected(clouds, recorded), recorded) < 0.1).all()


def test_after_a_gap_the_clouds_count_more_than_what_was_recorded_in_it() -> None:
    truth = {i: straight(i) for i in (*range(20), *range(40, 44))}
    find = FindOdometry()
    for i, T in truth.items():
        pose = find(combined(seen(T, seed=i)), START_NS + i * PERIOD_NS, T @ at(0.8 * (i >= 40)))
    assert pose is not None
    np.testing.assert_allclose(pose.T_fixed_site[:2, 3], truth[43][:2, 3], atol=0.05)


@pytest.mark.parametrize("clouds", ["of others that move", "bare ground", "empty"])
def test_recorded_motion_that_the_clouds_do_not_show_is_taken(clouds: str) -> None:
    recorded = [at(5.0 + 0.2 * i, 3.0) for i in range(10)]
    of_others = [seen(straight(i), seed=i) for i in range(10)]
    bare = [seen(T, WORLD[-1:], seed=i) for i, T in enumerate(recorded)]
    shown = {"of others that move": of_others, "bare ground": bare, "empty": [np.zeros((0, 3))] * 10}[clouds]
    for pose, T in zip(corrected(shown, recorded), recorded, strict=True):
        assert pose is None or (pose.is_predicted and np.allclose(pose.T_fixed_site, T))


@pytest.mark.parametrize(("jump_m", "noise_m"), [(3.0, 0.0), (0.0, 0.4)], ids=["jump", "noise"])
def test_recorded_steps_that_no_rig_makes_are_those_of_the_clouds(jump_m: float, noise_m: float) -> None:
    """A jump of a satellite receiver, and its noise without a filter."""
    random = np.random.default_rng(5)
    truth = [straight(i) for i in range(16)]
    recorded = [
        at(1.1 * i + jump_m * (i >= 8) + x, y) for i, (x, y) in enumerate(noise_m * random.normal(size=(16, 2)))
    ]
    poses = corrected([seen(T, seed=i) for i, T in enumerate(truth)], recorded)
    steps = np.diff([pose.T_fixed_site[:2, 3] for pose in poses if pose is not None], axis=0)
    assert len(steps) == 14
    np.testing.assert_allclose(steps[4:], np.tile([1.1, 0.0], (10, 1)), atol=0.25)


@pytest.mark.parametrize("clouds", ["seen", "bare ground"])
def test_hard_braking_is_no_jump(clouds: str) -> None:
    ways_m = np.cumsum([1.5] * 5 + [max(1.5 - 0.1 * k, 0.0) for k in range(12)])  # 10 m/s^2
    truth = [at(x) for x in ways_m]
    world = WORLD if clouds == "seen" else WORLD[-1:]
    poses = corrected([seen(T, world, seed=i) for i, T in enumerate(truth)], truth)
    there = np.array([pose.T_fixed_site[:2, 3] for pose in poses if pose is not None])
    np.testing.assert_allclose(there, np.c_[ways_m[1:], np.zeros(16)], atol=0.1)
