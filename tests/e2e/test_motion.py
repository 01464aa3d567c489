"""A moving vehicle, end to end: a wall that stands still comes out flat."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from builders import in_order, odometry, pointcloud2, raw, tf_message, transform_stamped, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from results import messages_of, stamp_of
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.messages import RawMessage

SPEED_M_S, TURN_RAD_S = 15.0, 0.4
START_NS = 1_600_000_000_000_000_000
SWEEP_NS, POSE_NS, LATE_NS, LOGGED_AFTER_NS = 100_000_000, 20_000_000, 1_000_000, 350_000_000
FRAMES, POINTS = 8, 1000
WALL_X_M = 60.0
MOUNT_M, MOUNT = (1.2, -0.3, 1.8), Rotation.from_euler("xyz", (2.0, -4.0, 30.0), degrees=True)
ALL_POINTS = ("--set", "combine.outliers.enabled=false", "--set", "combine.ground.enabled=false", "--set", CLUSTERS)
TF = "tf2_msgs/msg/TFMessage"


def vehicle_at(stamps_ns: I64) -> tuple[F64, Rotation]:
    """Position (N, 3) and heading on a circle, in the frame `odom`: the closed form, no integration."""
    seconds = (stamps_ns - START_NS) / 1e9
    yaw, radius_m = TURN_RAD_S * seconds, SPEED_M_S / TURN_RAD_S
    place = np.stack([radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), np.zeros_like(yaw)], -1)
    return place, Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])


def sweep(index: int) -> RawMessage:
    """One turn of the lidar over the wall: each point is measured from where the lidar is at that moment."""
    stamp_ns = START_NS + (index + 1) * SWEEP_NS
    rng = np.random.default_rng(index)
    offset_ns = np.sort(rng.integers(0, SWEEP_NS, POINTS)).astype(np.int64)
    wall = np.column_stack([np.full(POINTS, WALL_X_M), rng.uniform(-20, 20, POINTS), rng.uniform(0.5, 4, POINTS)])
    place, heading = vehicle_at(stamp_ns + offset_ns)
    xyz = MOUNT.inv().apply(heading.inv().apply(wall - place) - MOUNT_M).astype(np.float32)
    cloud = pointcloud2(xyz, stamp_ns=stamp_ns, frame_id="lidar", t=offset_ns.astype(np.uint32))
    return raw("/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, stamp_ns + LOGGED_AFTER_NS, "ros1")


def as_odometry() -> Iterator[RawMessage]:
    """Poses at 50 Hz, from before the first sweep to after the last one."""
    for stamp_ns in range(START_NS, START_NS + (FRAMES + 3) * SWEEP_NS, POSE_NS):
        place, heading = vehicle_at(np.array([stamp_ns], np.int64))
        xyzw = heading.as_quat()[0].tolist()
        pose = odometry(stamp_ns=stamp_ns, position=place[0].tolist(), orientation_xyzw=xyzw)
        yield raw("/odom", "nav_msgs/msg/Odometry", pose, stamp_ns, stamp_ns + LATE_NS, "ros1")


def clouds_of(path: Path) -> dict[int, F64]:
    """Points (N, 3) of the combined clouds by stamp."""
    found = {}
    for _, cloud in messages_of(path, "/point_cloud_combined"):
        columns = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)[:, :12].copy().view(np.float32)
        found[stamp_of(cloud)] = columns.astype(np.float64)
    return found


def depth_of_wall(stamp_ns: int, xyz_base: F64) -> F64:
    """(N,) metres behind the wall in `odom`, by the true pose of the vehicle at the frame's stamp."""
    place, heading = vehicle_at(np.array([stamp_ns], np.int64))
    return np.asarray((heading.apply(xyz_base) + place)[:, 0] - WALL_X_M)


def test_a_wall_that_stands_still_comes_out_flat(lidcam: Lidcam, tmp_path: Path) -> None:
    """Of a part, too: sweeps are recorded late, so that the poses of the first ones come before the window."""
    mount = transform_stamped(
        "base_link", "lidar", stamp_ns=START_NS, translation=MOUNT_M, rotation_xyzw=MOUNT.as_quat().tolist()
    )
    mounting = raw("/tf_static", TF, tf_message([mount]), START_NS, encoding="ros1")
    write_rosbag1(tmp_path / "a.bag", in_order([mounting], map(sweep, range(FRAMES)), as_odometry()))
    found = []
    for options in ((), ("--start", "0.5")):
        done = lidcam("process", tmp_path / "a.bag", tmp_path / "out.mcap", *ALL_POINTS, *options)
        assert done.code == 0, done.err
        found.append(clouds_of(tmp_path / "out.mcap"))
    whole, part = found
    assert 2 <= len(part) < len(whole) == FRAMES
    for stamp_ns, xyz in whole.items():
        assert len(xyz) == POINTS
        assert np.abs(depth_of_wall(stamp_ns, xyz)).max() < 0.01
    for stamp_ns, xyz in part.items():
        np.testing.assert_array_equal(xyz, whole[stamp_ns])
