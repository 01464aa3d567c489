"""One scene, recorded as the packets of a VLP-32C and as clouds: the same objects come out."""

from pathlib import Path

import numpy as np
import pytest
from builders import pointcloud2, raw, write_rosbag1, write_rosbag2
from command import Lidcam
from results import Found, fused_objects
from slabs import distance_to_box
from velodyne import scan

from bags.simulator.sensors.velodyne_packets import VelodyneSensor
from pipeline.core.arrays import F64
from pipeline.core.messages import RawMessage
from readers.velodyne.models import MODELS
from readers.velodyne.scan import parse_velodyne_scan

START_NS = 1_600_000_000_000_000_000
HEIGHT_M = 1.9
CARS = [((12.0, 4.0, -1.15), 0.3), ((9.0, -6.0, -1.15), 1.2), ((-14.0, 2.0, -1.15), -0.6)]
CAR_M = (4.2, 1.8, 1.5)
SENSOR = VelodyneSensor("VLP-32C", START_NS, start_azimuth_deg=140.0)
TURNS = 3


def ranges_of(origins: F64, directions: F64) -> F64:
    """First hit of each beam on the ground or a car; infinite where there is none."""
    with np.errstate(divide="ignore"):
        ground_m = (-HEIGHT_M - origins[:, 2]) / directions[:, 2]
    nearest_m = np.where((ground_m > 0) & (ground_m < 80), ground_m, np.inf)
    for center, yaw in CARS:
        distance_m = distance_to_box(origins, directions, np.array(center), np.array(CAR_M), yaw)
        nearest_m = np.minimum(nearest_m, distance_m)
    return nearest_m


def recorded() -> tuple[list[RawMessage], list[RawMessage]]:
    """The scans as packets and as clouds in the place of the beams, ROS 1."""
    as_packets, as_clouds = [], []
    packets = round(SENSOR.packets_per_turn)
    for turn in range(TURNS):
        beams = SENSOR.beams(turn * packets, packets)
        directions = beams.directions.reshape(-1, 3)
        origins = np.broadcast_to(beams.origins, beams.directions.shape).reshape(-1, 3)
        ranges_m = ranges_of(origins, directions)
        grid = ranges_m.reshape(beams.times_ns.shape)
        encoded = SENSOR.encode(turn * packets, grid, np.full(grid.shape, 50, np.uint8))
        stamp_ns = int(encoded.stamps_ns[0])
        message = scan(encoded.payload, encoded.stamps_ns, encoding="ros1")
        as_packets.append(message._replace(log_time_ns=stamp_ns + 100_000_000))

        step_m = MODELS["VLP-32C"].range_step_m
        hit = np.isfinite(ranges_m)
        xyz = (origins + directions * np.where(hit, np.rint(ranges_m / step_m) * step_m, 0)[:, None])[hit]
        offset_ns = (beams.times_ns.reshape(-1)[hit] - stamp_ns).astype(np.uint32)
        cloud = pointcloud2(xyz.astype(np.float32), stamp_ns=stamp_ns, frame_id="velodyne", t=offset_ns)
        as_clouds.append(raw("/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns, stamp_ns + 100_000_000, "ros1"))
    return as_packets, as_clouds


@pytest.fixture(scope="module")
def recordings() -> tuple[list[RawMessage], list[RawMessage]]:
    return recorded()


def objects(lidcam: Lidcam, recording: Path, *options: str) -> dict[int, list[Found]]:
    output = recording.parent / f"{recording.stem}_out.mcap"
    run = lidcam("process", recording, output, *options)
    assert run.code == 0, run.err
    return fused_objects(output)


def assert_same(one: dict[int, list[Found]], other: dict[int, list[Found]]) -> None:
    assert one.keys() == other.keys()
    for stamp_ns, found in one.items():
        assert [item.label for item in found] == [item.label for item in other[stamp_ns]]
        for a, b in zip(found, other[stamp_ns], strict=True):
            assert (a.x, a.y, a.z) == pytest.approx((b.x, b.y, b.z), abs=0.03)
            assert (a.length, a.width, a.height) == pytest.approx((b.length, b.width, b.height), abs=0.06)
            assert np.cos(a.yaw - b.yaw) > np.cos(np.deg2rad(1.5))


def test_packets_and_clouds_give_the_same_objects(
    lidcam: Lidcam, recordings: tuple[list[RawMessage], list[RawMessage]], tmp_path: Path
) -> None:
    as_packets, as_clouds = recordings
    write_rosbag1(tmp_path / "packets.bag", as_packets)
    write_rosbag1(tmp_path / "clouds.bag", as_clouds)
    found = objects(lidcam, tmp_path / "packets.bag")
    assert len(found) == TURNS
    for seen in found.values():
        assert len(seen) == len(CARS)
        for (x, y, _), _ in CARS:
            assert min(np.hypot(item.x - x, item.y - y) for item in seen) < 0.5
    assert_same(found, objects(lidcam, tmp_path / "clouds.bag"))


def test_ros2_without_definitions(
    lidcam: Lidcam, recordings: tuple[list[RawMessage], list[RawMessage]], tmp_path: Path
) -> None:
    cdr = []
    for message in recordings[0]:
        packets = parse_velodyne_scan(message)
        cdr.append(
            scan(packets.payload, packets.stamps_ns, stamp_ns=message.stamp_ns)._replace(
                log_time_ns=message.log_time_ns
            )
        )
    write_rosbag1(tmp_path / "packets.bag", recordings[0])
    write_rosbag2(tmp_path / "packets2", cdr, definitions=False)
    assert objects(lidcam, tmp_path / "packets.bag") == objects(lidcam, tmp_path / "packets2")


def test_what_the_settings_must_say_is_said(
    lidcam: Lidcam, recordings: tuple[list[RawMessage], list[RawMessage]], tmp_path: Path
) -> None:
    write_rosbag1(tmp_path / "packets.bag", recordings[0][:1])
    run = lidcam("process", tmp_path / "packets.bag", tmp_path / "o.mcap", "--set", "velodyne.model=HDL-64E S2")
    assert (run.code, "needs velodyne.calibration" in run.error_line) == (1, True)
    run = lidcam("process", tmp_path / "packets.bag", tmp_path / "o.mcap", "--set", "velodyne.model=VLP-16")
    assert (run.code, "velodyne.model says VLP-16, the packets say VLP-32C" in run.error_line) == (1, True)
