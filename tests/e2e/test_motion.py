"""A moving vehicle, end to end: a wall that stands still comes out flat, and the output says how the vehicle moved."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import odometry, pointcloud2, raw, tf_message, transform_stamped, write_rosbag1
from command import Lidcam
from results import messages_of, topics_of
from scipy.spatial.transform import Rotation

from pipeline.core.arrays import F64, I64
from pipeline.core.messages import RawMessage

SPEED_M_S, TURN_RAD_S = 15.0, 0.4
START_NS = 1_600_000_000_000_000_000
SWEEP_NS, POSE_NS, LATE_NS = 100_000_000, 20_000_000, 1_000_000
FRAMES, POINTS = 8, 1000
WALL_X_M = 60.0
MOUNT_M, MOUNT = (1.2, -0.3, 1.8), Rotation.from_euler("xyz", (2.0, -4.0, 30.0), degrees=True)
ALL_POINTS = ("--set", "combine.outliers.enabled=false", "--set", "combine.ground.enabled=false")


def vehicle_at(stamps_ns: I64) -> tuple[F64, Rotation]:
    """Position (N, 3) and heading on a circle, in the frame `odom`: the closed form, no integration."""
    seconds = (stamps_ns - START_NS) / 1e9
    yaw, radius_m = TURN_RAD_S * seconds, SPEED_M_S / TURN_RAD_S
    place = np.stack([radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), np.zeros_like(yaw)], -1)
    return place, Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])


def sweep(index: int, logged_after_ns: int = SWEEP_NS + LATE_NS) -> RawMessage:
    """One turn of the lidar over the wall: each point is measured from where the lidar is at that moment."""
    stamp_ns = START_NS + (index + 1) * SWEEP_NS
    rng = np.random.default_rng(index)
    offset_ns = np.sort(rng.integers(0, SWEEP_NS, POINTS)).astype(np.int64)
    wall = np.column_stack([np.full(POINTS, WALL_X_M), rng.uniform(-20, 20, POINTS), rng.uniform(0.5, 4, POINTS)])
    place, heading = vehicle_at(stamp_ns + offset_ns)
    xyz = MOUNT.inv().apply(heading.inv().apply(wall - place) - MOUNT_M).astype(np.float32)
    cloud = pointcloud2(xyz, stamp_ns=stamp_ns, frame_id="lidar", t=offset_ns.astype(np.uint32))
    return raw("/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, stamp_ns + logged_after_ns, "ros1")


def mount() -> RawMessage:
    edge = transform_stamped(
        "base_link", "lidar", stamp_ns=START_NS, translation=MOUNT_M, rotation_xyzw=MOUNT.as_quat().tolist()
    )
    return raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message([edge]), START_NS, encoding="ros1")


def poses() -> Iterator[tuple[int, list[float], list[float]]]:
    """Stamp, position and quaternion, at 50 Hz, from before the first sweep to after the last one."""
    for stamp_ns in range(START_NS, START_NS + (FRAMES + 3) * SWEEP_NS, POSE_NS):
        place, heading = vehicle_at(np.array([stamp_ns], np.int64))
        yield stamp_ns, place[0].tolist(), heading.as_quat()[0].tolist()


def as_odometry() -> list[RawMessage]:
    return [
        raw(
            "/odom",
            "nav_msgs/msg/Odometry",
            odometry(stamp_ns=stamp_ns, position=place, orientation_xyzw=xyzw),
            stamp_ns,
            stamp_ns + LATE_NS,
            "ros1",
        )
        for stamp_ns, place, xyzw in poses()
    ]


def as_tf() -> list[RawMessage]:
    return [
        raw(
            "/tf",
            "tf2_msgs/msg/TFMessage",
            tf_message(
                [transform_stamped("odom", "base_link", stamp_ns=stamp_ns, translation=place, rotation_xyzw=xyzw)]
            ),
            stamp_ns,
            stamp_ns + LATE_NS,
            "ros1",
        )
        for stamp_ns, place, xyzw in poses()
    ]


def recording(path: Path, motion: Iterable[RawMessage], logged_after_ns: int = SWEEP_NS + LATE_NS) -> Path:
    messages = [mount(), *(sweep(index, logged_after_ns) for index in range(FRAMES)), *motion]
    write_rosbag1(path, sorted(messages, key=lambda message: message.log_time_ns))
    return path


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def clouds_of(path: Path) -> dict[int, F64]:
    """Points (N, 3) of the combined cloud by stamp."""
    clouds = {}
    for _, message in messages_of(path, "/point_cloud_combined"):
        assert message.header.frame_id == "base_link"
        assert [field.name for field in message.fields[:3]] == ["x", "y", "z"]
        rows = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_step)
        clouds[stamp_of(message.header)] = rows[:, :12].copy().view("<f4").astype(np.float64)
    return clouds


def depth_of_wall(stamp_ns: int, xyz_base: F64) -> F64:
    """How far each point lies behind the wall in `odom`, by the true pose of the vehicle at the frame's stamp."""
    place, heading = vehicle_at(np.array([stamp_ns], np.int64))
    return np.asarray((heading.apply(xyz_base) + place)[:, 0] - WALL_X_M)


@pytest.mark.parametrize("motion", [as_odometry, as_tf])
def test_a_wall_that_stands_still_comes_out_flat(
    lidcam: Lidcam, tmp_path: Path, motion: Callable[[], list[RawMessage]]
) -> None:
    bag, out = recording(tmp_path / "a.bag", motion()), tmp_path / "out.mcap"
    run = lidcam("process", bag, out, *ALL_POINTS)
    assert run.code == 0, run.err
    assert f"{FRAMES} of {FRAMES} frames compensated" in run.out
    clouds = clouds_of(out)
    assert len(clouds) == FRAMES
    for stamp_ns, xyz in clouds.items():
        assert len(xyz) == POINTS
        assert np.abs(depth_of_wall(stamp_ns, xyz)).max() < 0.01


def test_without_compensation_the_wall_is_as_thick_as_the_way_driven(lidcam: Lidcam, tmp_path: Path) -> None:
    bag, out = recording(tmp_path / "a.bag", as_odometry()), tmp_path / "out.mcap"
    run = lidcam("process", bag, out, *ALL_POINTS, "--set", "combine.motion.enabled=false")
    assert run.code == 0, run.err
    way_m = SPEED_M_S * SWEEP_NS / 1e9
    for stamp_ns, xyz in clouds_of(out).items():
        assert np.ptp(depth_of_wall(stamp_ns, xyz)) > 0.8 * way_m
    assert "/tf" not in topics_of(out)


@pytest.mark.parametrize("motion", [as_odometry, as_tf])
def test_tf_tells_where_the_vehicle_was_at_each_frame(
    lidcam: Lidcam, tmp_path: Path, motion: Callable[[], list[RawMessage]]
) -> None:
    bag, out = recording(tmp_path / "a.bag", motion()), tmp_path / "out.mcap"
    assert lidcam("process", bag, out).code == 0
    edges = [message.transforms[0] for _, message in messages_of(out, "/tf")]
    assert [stamp_of(edge.header) for edge in edges] == [START_NS + (k + 1) * SWEEP_NS for k in range(FRAMES)]
    for edge in edges:
        assert (edge.header.frame_id, edge.child_frame_id) == ("odom", "base_link")
        place, heading = vehicle_at(np.array([stamp_of(edge.header)], np.int64))
        shift, turn = edge.transform.translation, edge.transform.rotation
        np.testing.assert_allclose([shift.x, shift.y, shift.z], place[0], atol=1e-3)
        off = heading[0].inv() * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
        assert off.magnitude() < 1e-4
    (mounted,) = messages_of(out, "/tf_static")[0][1].transforms
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("base_link", "lidar")
    shift = mounted.transform.translation
    np.testing.assert_allclose([shift.x, shift.y, shift.z], MOUNT_M)
    for _, message in messages_of(out, "/diagnostics"):
        values = {pair.key: pair.value for status in message.status for pair in status.values}
        assert values["motion compensated"] == "lidar"


def test_odometry_of_another_car_moves_nothing(lidcam: Lidcam, tmp_path: Path) -> None:
    others = [
        raw(
            "/car1/base_pose_ground_truth",
            "nav_msgs/msg/Odometry",
            odometry(stamp_ns=stamp_ns, frame_id="map", child_frame_id="car1", position=place, orientation_xyzw=xyzw),
            stamp_ns,
            stamp_ns + LATE_NS,
            "ros1",
        )
        for stamp_ns, place, xyzw in poses()
    ]
    out = tmp_path / "out.mcap"
    assert lidcam("process", recording(tmp_path / "a.bag", others), out, *ALL_POINTS).code == 0
    assert "/tf" not in topics_of(out)


def test_a_part_of_the_recording_gives_the_frames_of_the_whole(lidcam: Lidcam, tmp_path: Path) -> None:
    bag = recording(tmp_path / "a.bag", as_odometry())
    whole, part = tmp_path / "whole.mcap", tmp_path / "part.mcap"
    assert lidcam("process", bag, whole, *ALL_POINTS).code == 0
    run = lidcam("process", bag, part, *ALL_POINTS, "--start", "0.45", "--duration", "0.3")
    assert run.code == 0, run.err
    expected, found = clouds_of(whole), clouds_of(part)
    assert 2 <= len(found) < FRAMES
    for stamp_ns, xyz in found.items():
        np.testing.assert_array_equal(xyz, expected[stamp_ns])


@pytest.mark.parametrize(
    ("logged_after_ns", "options"),
    [(0, ()), (350_000_000, ("--start", "0.5"))],
    ids=["poses of a sweep recorded after it", "poses of the first sweeps recorded before the window"],
)
def test_sweeps_and_poses_recorded_at_different_times(
    lidcam: Lidcam, tmp_path: Path, logged_after_ns: int, options: tuple[str, ...]
) -> None:
    bag, out = recording(tmp_path / "a.bag", as_odometry(), logged_after_ns), tmp_path / "out.mcap"
    run = lidcam("process", bag, out, *ALL_POINTS, *options)
    assert run.code == 0, run.err
    clouds = clouds_of(out)
    assert len(clouds) == FRAMES if not options else 2 <= len(clouds) < FRAMES
    for stamp_ns, xyz in clouds.items():
        assert np.abs(depth_of_wall(stamp_ns, xyz)).max() < 0.01
