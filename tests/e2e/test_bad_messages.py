"""One message of which half is missing: counted under its topic, or the end of the run; never passed over."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import camera_info, image, odometry, pointcloud2, raw, tf_message, transform_stamped, write_rosbag1
from command import Lidcam
from small_drive import small_drive

from pipeline.core.messages import RawMessage

STEP_NS, FRAMES = 100_000_000, 6
CAMERA = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])


def recording(path: Path, *, bad: str) -> Path:
    """A lidar, a camera and odometry, of which one message of the topic `bad` is cut."""
    points = np.random.default_rng(0).uniform([5, -5, -1], [15, 5, 1], (200, 3)).astype(np.float32)
    edges = [
        transform_stamped("base_link", "lidar", stamp_ns=1),
        transform_stamped("base_link", "cam", stamp_ns=1, rotation_xyzw=(-0.5, 0.5, -0.5, 0.5)),
    ]
    messages: list[RawMessage] = []

    def add(topic: str, msgtype: str, message: Mapping[str, Any], stamp_ns: int) -> None:
        messages.append(raw(topic, msgtype, message, stamp_ns, encoding="ros1"))

    add("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(edges), 1)
    for stamp_ns in range(10**9, 10**9 + FRAMES * STEP_NS, STEP_NS):
        image_message = image(np.zeros((48, 64, 3), np.uint8), stamp_ns=stamp_ns, frame_id="cam")
        info = camera_info(CAMERA, stamp_ns=stamp_ns, width_px=64, height_px=48, frame_id="cam")
        add("/points", "sensor_msgs/msg/PointCloud2", pointcloud2(points, stamp_ns=stamp_ns), stamp_ns)
        add("/cam/image_raw", "sensor_msgs/msg/Image", image_message, stamp_ns)
        add("/cam/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns)
        add("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=stamp_ns), stamp_ns)
    rows = [row for row, message in enumerate(messages) if message.topic == bad]
    row = rows[len(rows) // 2]
    messages[row] = messages[row]._replace(data=messages[row].data[: len(messages[row].data) // 2])
    write_rosbag1(path, messages)
    return path


TOPICS = pytest.mark.parametrize("bad", ["/odom", "/cam/image_raw", "/points", "/tf_static"])


@TOPICS
def test_it_is_counted(lidcam: Lidcam, tmp_path: Path, bad: str) -> None:
    run = lidcam("process", recording(tmp_path / "a.bag", bad=bad), tmp_path / "out.mcap", "--json")
    assert run.code == 3, run.err
    (drop,) = (drop for drop in json.loads(run.out)["drops"] if drop["topic"] == bad)
    assert drop["count"] == 1
    assert drop["reason"]
    assert json.loads(run.out)["exit_code"] == 3
    assert run.err.splitlines()[-1].startswith("lidcam: incomplete: ")
    inspected = lidcam("inspect", tmp_path / "a.bag")
    assert inspected.code == (3 if bad == "/tf_static" else 0)  # it decodes what it needs for the calibration only
    verdict = "cam (/cam/image_raw) is left out" if bad == "/tf_static" else "sound, and all of its sensors can be used"
    assert inspected.out.splitlines()[-1] == f"verdict: {verdict}"


@TOPICS
def test_it_ends_the_run(lidcam: Lidcam, tmp_path: Path, bad: str) -> None:
    out = tmp_path / "out.mcap"
    run = lidcam("process", recording(tmp_path / "a.bag", bad=bad), out, "--on-bad-message", "fail")
    assert run.code == 1
    assert bad in run.error_line
    assert not out.exists()


@pytest.mark.parametrize(
    ("topic", "stamp"),
    [
        ("/points", b"\xff" * 8),
        ("/cam/image_raw", b"\0\0\0\x80" + bytes(4)),
        ("/odom", b"\xff\xff\xff\x7f" + b"\xff" * 4),
    ],
)
def test_a_stamp_that_cannot_be_a_time(lidcam: Lidcam, tmp_path: Path, topic: str, stamp: bytes) -> None:
    """The last message of its topic, which no later one shows to be wrong; all other frames are written."""
    messages = small_drive("ros1", frames=FRAMES)
    row = max(row for row, message in enumerate(messages) if message.topic == topic)
    data = bytes(messages[row].data)
    messages[row] = messages[row]._replace(data=data[:4] + stamp + data[12:])
    write_rosbag1(tmp_path / "a.bag", messages)
    out = tmp_path / "out.mcap"
    run = lidcam("process", tmp_path / "a.bag", out, "--json")
    assert run.code in {0, 3}, run.err
    report = json.loads(run.out)
    assert report["frames"] == FRAMES - (topic == "/points")
    counts = {drop["reason"]: drop["count"] for drop in report["drops"] if drop["topic"] == topic}
    assert counts == {"its stamp cannot be a time": 1}
    assert out.exists()

    run = lidcam("process", tmp_path / "a.bag", tmp_path / "other.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert f"{topic}: stamp " in run.error_line
