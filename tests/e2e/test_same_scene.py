"""One scene in every container, as clouds, as scans of packets, as single packets and as a capture: the same objects.

The clouds hold the points that the packets decode to, so that all results have to be equal to the last bit.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import (
    Encoding,
    camera_info,
    detection2d_array,
    in_order,
    pointcloud2,
    raw,
    tf_message,
    transform_stamped,
    write_rosbag1,
    write_rosbag2,
)
from captures import capture_of, pcap
from results import Found, fused_objects
from velodyne import packet_stream, scan

from lidcam.bags.simulator.sensors.beams import VelodyneSensor
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import VelodyneLidarConfig
from lidcam.processing import process_recording
from lidcam.readers.velodyne.decoder import VelodyneDecoder
from lidcam.run.job import make_job

START_NS = 1_600_000_000_000_000_000
HEIGHT_M = 1.9
CAR_M = np.array([4.2, 1.8, 1.5])
CARS = [((12.0, 4.0, -1.15), 0.3), ((9.0, -5.0, -1.15), 1.2), ((-14.0, 2.0, -1.15), -0.6)]
SENSOR = VelodyneSensor("VLP-32C", START_NS)
TURNS = 3
STARTS = np.ceil(np.arange(TURNS + 1) * SENSOR.packets_per_turn - 1e-6).astype(int)
"""First packet of each turn; the last turn ends with the recording."""

K = np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]])
CAMERA_XYZW = (-0.5, 0.5, -0.5, 0.5)
RECORDED_NS = 5_000_000
CAPTURED = "/velodyne_192_168_1_201/packets"


def distance_to_box(origins: F64, directions: F64, center: F64, yaw: float) -> F64:
    """Distance (N,) to a car along each ray by the slab method (Kay and Kajiya 1986), infinite for a miss."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    start, along = (origins - center) @ turn.T, directions @ turn.T
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    enter = ((-np.sign(along) * CAR_M / 2 - start) / along).max(1)
    leave = ((np.sign(along) * CAR_M / 2 - start) / along).min(1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def ranges_of(origins: F64, directions: F64) -> F64:
    with np.errstate(divide="ignore"):
        ground_m = (-HEIGHT_M - origins[:, 2]) / directions[:, 2]
    nearest_m = np.where((ground_m > 0) & (ground_m < 40), ground_m, np.inf)
    for center, yaw in CARS:
        nearest_m = np.minimum(nearest_m, distance_to_box(origins, directions, np.array(center), yaw))
    return nearest_m


def boxes_px() -> list[list[float]]:
    """The cars ahead in the image of a camera at the lidar."""
    boxes = []
    for center, yaw in CARS[:2]:
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * CAR_M / 2
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        x, y, z = (corners @ turn.T + center).T
        u, v = 320 - 300 * y / x, 240 - 300 * z / x
        boxes.append([u.min(), v.min(), u.max(), v.max()])
    return boxes


class Scene:
    """The scene in ROS 1 and in ROS 2 messages."""

    def __init__(self) -> None:
        count = int(STARTS[-1])
        beams = SENSOR.beams(0, count)
        directions = beams.directions.reshape(-1, 3)
        origins = np.broadcast_to(beams.origins, beams.directions.shape).reshape(-1, 3)
        grid = ranges_of(origins, directions).reshape(beams.times_ns.shape)
        packets = SENSOR.encode(0, grid, np.full(grid.shape, 50, np.uint8))
        self.payload, self.stamps_ns = packets.payload, packets.stamps_ns
        self.turns = [slice(begin, end) for begin, end in pairwise(STARTS)]

    def scans(self, encoding: Encoding) -> list[RawMessage]:
        scans = [scan(self.payload[turn], self.stamps_ns[turn], encoding=encoding) for turn in self.turns]
        ends_ns = [int(self.stamps_ns[turn][-1]) for turn in self.turns]
        return [m._replace(log_time_ns=end + RECORDED_NS) for m, end in zip(scans, ends_ns, strict=True)]

    def packets(self, encoding: Encoding) -> list[RawMessage]:
        stream = packet_stream(self.payload, self.stamps_ns, encoding=encoding)
        return [m._replace(log_time_ns=m.log_time_ns + RECORDED_NS) for m in stream]

    def clouds(self, encoding: Encoding) -> list[RawMessage]:
        """What the scans decode to."""
        decode, clouds = VelodyneDecoder(VelodyneLidarConfig()), []
        for message in self.scans(encoding):
            cloud = decode(message)
            time_s = (cloud.time_offset_ns / 1e9).astype(np.float32)
            fields = pointcloud2(
                cloud.xyz,
                stamp_ns=message.stamp_ns,
                frame_id="velodyne",
                intensity=cloud.intensity,
                ring=cloud.ring,
                time=time_s,
            )
            at = message.stamp_ns, message.log_time_ns, encoding
            clouds.append(raw("/velodyne_points", "sensor_msgs/msg/PointCloud2", fields, *at))
        return clouds

    def others(self, encoding: Encoding) -> list[RawMessage]:
        """Boxes of a camera, its calibration, and where both sensors are."""
        edges = [
            transform_stamped(
                "base_link", child, stamp_ns=START_NS, translation=(0, 0, HEIGHT_M), rotation_xyzw=rotation_xyzw
            )
            for child, rotation_xyzw in (("velodyne", (0, 0, 0, 1)), ("camera", CAMERA_XYZW))
        ]
        found = [raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(edges), START_NS, START_NS, encoding)]
        for turn in self.turns:
            at_ns = int(self.stamps_ns[turn][0])
            info = camera_info(K, stamp_ns=at_ns, width_px=640, height_px=480, frame_id="camera")
            boxes = detection2d_array(
                boxes_px(), class_names=["car"] * 2, scores=[0.9] * 2, stamp_ns=at_ns, frame_id="camera"
            )
            messages: list[tuple[str, str, Any]] = [
                ("/camera/camera_info", "sensor_msgs/msg/CameraInfo", info),
                ("/camera/detections", "vision_msgs/msg/Detection2DArray", boxes),
            ]
            found += [raw(*message, at_ns, at_ns + RECORDED_NS, encoding) for message in messages]
        return found


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


def objects(*inputs: Path, rig: Path | None = None) -> dict[int, list[Found]]:
    """What `lidcam process` finds, to 0.1 mm: times of points are finer in packets than in clouds.

    Called here, because to start a program takes longer than the scene.
    """
    out = inputs[0].parent / "out.mcap"
    # The cars are cuboids, which look like no car.
    settings = {"detect3d.score": "geometric"}
    process_recording(make_job(inputs, out, rig=rig, settings=settings, on_bad_message="fail"))
    return {stamp_ns: [_rounded(one) for one in found] for stamp_ns, found in fused_objects(out).items()}


def _rounded(found: Found) -> Found:
    numbers = (found.score, found.x, found.y, found.z, found.yaw, found.length, found.width, found.height)
    return Found(found.label, *(round(number, 4) for number in numbers))


@pytest.fixture(scope="module")
def expected(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> dict[int, list[Found]]:
    """Of the clouds in a ROS 1 bag."""
    folder = tmp_path_factory.mktemp("expected")
    write_rosbag1(folder / "clouds.bag", in_order(scene.clouds("ros1"), scene.others("ros1")))
    found = objects(folder / "clouds.bag")
    assert [*found] == [int(scene.stamps_ns[turn][0]) for turn in scene.turns]
    for seen in found.values():
        assert len(seen) == len(CARS)
        for (x, y, _), _ in CARS:
            assert min(np.hypot(item.x - x, item.y - y) for item in seen) < 0.5
    return found


@pytest.mark.parametrize("form", ["clouds, mcap", "scans, ros2", "packets, ros1"])
def test_the_same_objects(form: str, scene: Scene, expected: dict[int, list[Found]], tmp_path: Path) -> None:
    kind, container = form.split(", ")
    encoding: Encoding = "ros1" if "ros1" in container else "cdr"
    lidar = {"clouds": scene.clouds, "scans": scene.scans, "packets": scene.packets}[kind](encoding)
    messages, path = in_order(lidar, scene.others(encoding)), tmp_path / "recording"
    if container == "ros1":
        write_rosbag1(path, messages)
    else:
        write_rosbag2(path, messages, "sqlite3" if kind == "scans" else "mcap", definitions=kind == "clouds")
    assert objects(path) == expected


def test_a_capture_beside_a_bag(scene: Scene, expected: dict[int, list[Found]], tmp_path: Path) -> None:
    """The rig file says which lidar of tf the sender is."""
    (tmp_path / "velodyne.pcap").write_bytes(pcap(capture_of(scene.payload, scene.stamps_ns)))
    write_rosbag2(tmp_path / "drive", scene.others("cdr"))
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"lidars: {{top: {{topic: {CAPTURED}, frame_id: velodyne}}}}\n")
    inputs = tmp_path / "velodyne.pcap", tmp_path / "drive"
    assert objects(*inputs, rig=rig) == expected
