"""A moving vehicle, end to end: a wall that stands still comes out flat, and the output says how the vehicle moved."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from builders import in_order, odometry, pointcloud2, raw, tf_message, transform_stamped, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS
from results import messages_of, stamp_of
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.messages import RawMessage

SPEED_M_S, TURN_RAD_S = 15.0, 0.4
START_NS = 1_600_000_000_000_000_000
SWEEP_NS, POSE_NS, LATE_NS = 100_000_000, 20_000_000, 1_000_000
FRAMES, POINTS = 8, 1000
WALL_X_M = 60.0
MOUNT_M, MOUNT = (1.2, -0.3, 1.8), Rotation.from_euler("xyz", (2.0, -4.0, 30.0), degrees=True)
ALL_POINTS = ("--set", "combine.outliers.enabled=false", "--set", "combine.ground.enabled=false", "--set", CLUSTERS)
TF = "tf2_msgs/msg/TFMessage"

Process = Callable[..., Path]


def vehicle_at(stamps_ns: I64) -> tuple[F64, Rotation]:
    """Position (N, 3) and heading on a circle, in the frame `odom`: the closed form, no integration."""
    seconds = (stamps_ns - START_NS) / 1e9
    yaw, radius_m = TURN_RAD_S * seconds, SPEED_M_S / TURN_RAD_S
    place = np.stack([radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), np.zeros_like(yaw)], -1)
    return place, Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])


def sweep(index: int, logged_after_ns: int) -> RawMessage:
    """One turn of the lidar over the wall: each point is measured from where the lidar is at that moment."""
    stamp_ns = START_NS + (index + 1) * SWEEP_NS
    rng = np.random.default_rng(index)
    offset_ns = np.sort(rng.integers(0, SWEEP_NS, POINTS)).astype(np.int64)
    wall = np.column_stack([np.full(POINTS, WALL_X_M), rng.uniform(-20, 20, POINTS), rng.uniform(0.5, 4, POINTS)])
    place, heading = vehicle_at(stamp_ns + offset_ns)
    xyz = MOUNT.inv().apply(heading.inv().apply(wall - place) - MOUNT_M).astype(np.float32)
    cloud = pointcloud2(xyz, stamp_ns=stamp_ns, frame_id="lidar", t=offset_ns.astype(np.uint32))
    return raw("/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, stamp_ns + logged_after_ns, "ros1")


def poses() -> Iterator[tuple[int, list[float], list[float]]]:
    """Stamp, position and quaternion, at 50 Hz, from before the first sweep to after the last one."""
    for stamp_ns in range(START_NS, START_NS + (FRAMES + 3) * SWEEP_NS, POSE_NS):
        place, heading = vehicle_at(np.array([stamp_ns], np.int64))
        yield stamp_ns, place[0].tolist(), heading.as_quat()[0].tolist()


def as_odometry() -> list[RawMessage]:
    found = []
    for stamp_ns, place, xyzw in poses():
        pose = odometry(stamp_ns=stamp_ns, position=place, orientation_xyzw=xyzw)
        found.append(raw("/odom", "nav_msgs/msg/Odometry", pose, stamp_ns, stamp_ns + LATE_NS, "ros1"))
    return found


@pytest.fixture(scope="module")
def process(lidcam: Lidcam, tmp_path_factory: pytest.TempPathFactory) -> Process:
    """Record the drive and process it."""

    def run(motion: Iterable[RawMessage], *options: str, logged_after_ns: int = SWEEP_NS + LATE_NS) -> Path:
        folder = tmp_path_factory.mktemp("drive")
        xyzw = MOUNT.as_quat().tolist()
        mount = transform_stamped("base_link", "lidar", stamp_ns=START_NS, translation=MOUNT_M, rotation_xyzw=xyzw)
        sweeps = [sweep(index, logged_after_ns) for index in range(FRAMES)]
        mounting = raw("/tf_static", TF, tf_message([mount]), START_NS, encoding="ros1")
        write_rosbag1(folder / "a.bag", in_order([mounting], sweeps, motion))
        done = lidcam("process", folder / "a.bag", folder / "out.mcap", *ALL_POINTS, *options)
        assert done.code == 0, done.err
        return folder / "out.mcap"

    return run


@pytest.fixture(scope="module")
def moved(process: Process) -> Path:
    """What becomes of the drive."""
    return process(as_odometry())


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


def assert_flat(clouds: dict[int, F64]) -> None:
    for stamp_ns, xyz in clouds.items():
        assert len(xyz) == POINTS
        assert np.abs(depth_of_wall(stamp_ns, xyz)).max() < 0.01


def test_a_wall_that_stands_still_comes_out_flat(moved: Path) -> None:
    assert_flat(clouds := clouds_of(moved))
    assert len(clouds) == FRAMES


def test_tf_tells_where_the_vehicle_was_at_each_frame(moved: Path) -> None:
    edges = [message.transforms[0] for _, message in messages_of(moved, "/tf")]
    assert [stamp_of(edge) for edge in edges] == [START_NS + (k + 1) * SWEEP_NS for k in range(FRAMES)]
    for edge in edges:
        assert (edge.header.frame_id, edge.child_frame_id) == ("odom", "base_link")
        place, heading = vehicle_at(np.array([stamp_of(edge)], np.int64))
        shift, turn = edge.transform.translation, edge.transform.rotation
        np.testing.assert_allclose([shift.x, shift.y, shift.z], place[0], atol=1e-3)
        off = heading[0].inv() * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
        assert off.magnitude() < 1e-4
    (mounted,) = messages_of(moved, "/tf_static")[0][1].transforms
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("base_link", "lidar")
    shift = mounted.transform.translation
    np.testing.assert_allclose([shift.x, shift.y, shift.z], MOUNT_M)
    for _, message in messages_of(moved, "/diagnostics"):
        values = {pair.key: pair.value for status in message.status for pair in status.values}
        assert values["motion compensated"] == "lidar"


def test_a_part_of_the_recording_gives_the_frames_of_the_whole(process: Process) -> None:
    """Sweeps that are recorded late, so that the poses of the first ones come before the window."""
    whole = clouds_of(process(as_odometry(), logged_after_ns=350_000_000))
    part = clouds_of(process(as_odometry(), "--start", "0.5", logged_after_ns=350_000_000))
    assert_flat(whole)
    assert 2 <= len(part) < FRAMES
    for stamp_ns, xyz in part.items():
        np.testing.assert_array_equal(xyz, whole[stamp_ns])
