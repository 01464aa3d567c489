"""A lidar whose pose was stored the other way round is told by the ground below it."""

from dataclasses import replace

import numpy as np
import pytest
from detections import forward_camera
from frames import RIG
from lidar_scene import point_cloud
from scipy.spatial.transform import Rotation

from lidcam.checks.calibration.first_clouds import cameras_without_points, early_cloud, inverted_lidars, tilted_lidars
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig

POSES = {"a": ([3.0, 1, 1.8], [0, 0, 20]), "b": ([-2.0, 0, 2.4], [2, -3, 130]), "c": ([0.0, -5, 1.2], [0, 5, -70])}


def lidar(name: str) -> LidarSensor:
    position, rpy_deg = POSES[name]
    quaternion = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_quat()
    return LidarSensor(name, f"/{name}", Transform.from_quaternion("site", name, position, quaternion))


def inverted(sensor: LidarSensor) -> LidarSensor:
    inverse = sensor.T_site_lidar.inverse()
    return replace(sensor, T_site_lidar=Transform("site", sensor.name, inverse.matrix))


def measured(sensor: LidarSensor) -> PointCloud:
    """A cloud of flat ground at z = 0 and a few posts, in the lidar's frame."""
    random = np.random.default_rng(1)
    ground = np.c_[random.uniform(-15, 15, (3000, 2)), random.normal(0, 0.01, 3000)]
    posts = np.c_[np.repeat(random.uniform(-15, 15, (20, 2)), 20, 0), np.tile(np.linspace(0, 3, 20), 20)]
    xyz = sensor.T_site_lidar.inverse().apply(np.concatenate([ground, posts]))
    return point_cloud(xyz, sensor.name)


def warned(names: str, wrong: str = "", ground_height_m: float | None = None) -> list[str]:
    """Lidars that are warned of; those of `wrong` have inverted poses."""
    true = [lidar(name) for name in names]
    given = tuple(inverted(sensor) if sensor.name in wrong else sensor for sensor in true)
    rig: Rig = replace(RIG, lidars=given, ground_height_m=ground_height_m)
    clouds = {sensor.name: measured(sensor) for sensor in true}
    return [warning.subject for warning in inverted_lidars(rig, CombineConfig(), clouds)]


@pytest.mark.parametrize(
    ("names", "wrong", "ground_height_m", "expected"),
    [
        ("abc", "", None, []),
        ("abc", "a", None, ["a"]),
        ("ab", "b", None, ["b"]),
        ("a", "a", None, []),  # nothing to compare with
        ("a", "a", 0.0, ["a"]),
        ("abc", "ab", 0.0, ["a", "b"]),
        ("a", "", 9.0, []),  # neither pose fits
    ],
)
def test_inverted_poses(names: str, wrong: str, ground_height_m: float | None, expected: list[str]) -> None:
    assert warned(names, wrong, ground_height_m) == expected


def test_two_lidars_of_one_height_contradict_each_other() -> None:
    same = replace(lidar("b"), T_site_lidar=Transform("site", "b", lidar("a").T_site_lidar.matrix))
    rig = replace(RIG, lidars=(lidar("a"), inverted(same)), ground_height_m=None)
    first, second = inverted_lidars(rig, CombineConfig(), {"a": measured(lidar("a")), "b": measured(same)})
    assert str(first) == (
        "a: its ground lies at z = 0.00 m, and with the inverse of its extrinsics at -3.60 m, where it belongs "
        "(-3.60 m); they look inverted (or those of b: they contradict each other): T_site_lidar maps points of the "
        "lidar to the site"
    )
    assert second.subject == "b"


@pytest.mark.parametrize(
    ("turned_deg", "tilt"), [([45, 0, 0], "45"), ([0, -30, 0], "30"), ([0, 0, 45], None), ([4, 0, 0], None)]
)
def test_a_lidar_whose_mount_was_forgotten(turned_deg: list[float], tilt: str | None) -> None:
    true = [lidar("a"), lidar("b")]
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", turned_deg, degrees=True).as_matrix()
    pose = true[1].T_site_lidar
    level = Transform.from_quaternion("site", "b", tuple(pose.translation), (0, 0, 0, 1))
    clouds = {"a": measured(true[0]), "b": measured(replace(true[1], T_site_lidar=level))}
    given = replace(true[1], T_site_lidar=replace(level, matrix=level.matrix @ turn))
    found = tilted_lidars(replace(RIG, lidars=(true[0], given)), CombineConfig(), clouds)
    told = [f"its ground is tilted by {tilt} degrees in the site, and that of a is level"] if tilt else []
    assert [warning.finding for warning in found] == told
    assert tilted_lidars(replace(RIG, lidars=(given,)), CombineConfig(), clouds) == (), "nobody to compare it with"


@pytest.mark.parametrize(
    ("delay_ms", "first_ms", "set_ms", "early_ms"),
    [
        (108, 0, 0, None),  # stamped at the start of the sweep
        (8, -100, 0, None),  # at its end
        (58, 0, 0, "42"),  # in the middle, and times count from the start
        (8, 0, 0, "92"),
        (8, 0, 100, None),  # the rig says so
        (95, 0, 0, None),  # clocks differ
        (0, 0, 0, None),  # converted: the log time is the stamp
        (-5000, 0, 0, None),  # the clock is ahead
    ],
)
def test_clouds_recorded_before_their_last_point(
    delay_ms: int, first_ms: int, set_ms: int, early_ms: str | None
) -> None:
    times_ns = (1e6 * np.linspace(first_ms, first_ms + 100, 50)).astype(np.int32)
    cloud = replace(point_cloud(np.ones((50, 3))), time_offset_ns=times_ns, has_time=True)
    found = early_cloud(replace(lidar("a"), time_offset_ns=set_ms * 10**6), cloud, delay_ms * 10**6)
    told = f"its first cloud was recorded {early_ms} ms before its last point was measured" if early_ms else None
    assert (found and found.finding) == told


@pytest.mark.parametrize("names", ["a", "ab"])
def test_a_lidar_that_hangs_upside_down(names: str) -> None:
    true = [lidar(name) for name in names]
    clouds = {one.name: measured(one) for one in true}
    over = replace(true[0].T_site_lidar, matrix=true[0].T_site_lidar.matrix @ np.diag([1.0, -1, -1, 1]))
    rig = replace(RIG, lidars=(replace(true[0], T_site_lidar=over), *true[1:]))
    (warning,) = tilted_lidars(rig, CombineConfig(), clouds)
    assert str(warning).startswith("a: its ground is above it in the site; check the roll and pitch")


@pytest.mark.parametrize(
    ("point", "count", "cameras", "remark"),
    [
        ((10, 0, 0), 600, 0, ""),
        ((-10, 0, 0), 600, 2, "; check its extrinsics and the frame that they are given in"),
        ((-10, 0, 0), 400, 0, ""),  # too few points
        ((10, 0, 9), 600, 2, ";"),  # above the image
        ((0, -10, 0), 600, 2, " (600 do with the inverse of its extrinsics); check its extrinsics and the frame that"),
    ],
)
def test_cameras_without_a_point_in_the_image(point: tuple[float, ...], count: int, cameras: int, remark: str) -> None:
    rig = replace(RIG, cameras=(forward_camera("one"), forward_camera("two")))
    found = cameras_without_points(rig, np.tile(np.array([point], np.float64), (count, 1)))
    assert [warning.subject for warning in found] == ["one", "two"][:cameras]
    assert all(f"none of {count} lidar points falls into its image{remark}" in str(warning) for warning in found)


def test_a_camera_in_the_axes_of_its_body_looks_at_the_sky() -> None:
    camera = forward_camera()
    body = replace(camera, T_camera_site=Transform("cam", "site", np.eye(4)))
    (warning,) = cameras_without_points(replace(RIG, cameras=(camera, body)), np.tile([[10.0, 0, 0]], (600, 1)))
    assert str(warning).endswith(
        "falls into its image, and it looks at the sky; if its pose is that of its body (x forward), give that of its "
        "optical frame (z forward, x right)"
    )
