"""Sensors that fall silent, start late or are slow: every frame is there, and what it lacks is told."""

import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import camera_info, image, pointcloud2, raw, tf_message, transform_stamped, write_rosbag1
from command import Lidcam
from helpers import CLUSTERS

from lidcam.pipeline.core.messages import RawMessage

START_NS = 1_700_000_000 * 10**9
STEP_NS = 100_000_000
MINUTE_NS = 60 * 10**9
LATER = {"shift_ns": MINUTE_NS, "late_ns": MINUTE_NS}
CAMERAS = [f"cam{number}" for number in range(1, 6)]
LIDARS = ["front", "rear"]
Taken = Callable[[str, int], bool]


def recorded(taken: Taken) -> list[RawMessage]:
    """Two lidars and eight cameras at 10 Hz; `taken` says which of their measurements there are."""
    points = np.random.default_rng(0).uniform([5, -5, -1], [15, 5, 1], (50, 3)).astype(np.float32)
    pixels = np.zeros((6, 8, 3), np.uint8)
    edges = [transform_stamped("base_link", name, stamp_ns=START_NS) for name in (*LIDARS, *CAMERAS)]
    messages = [message("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(edges), START_NS)]
    for step in range(30):
        stamp_ns = START_NS + step * STEP_NS
        for name in LIDARS:
            if taken(name, step):
                seen = points + np.float32(0.3 * LIDARS.index(name))  # by each from its own place
                cloud = pointcloud2(seen, stamp_ns=stamp_ns, frame_id=name)
                messages.append(message(f"/{name}/points", "sensor_msgs/msg/PointCloud2", cloud, stamp_ns))
        for name in CAMERAS:
            if step == 0:
                info = camera_info(
                    [[8, 0, 4], [0, 8, 3], [0, 0, 1]], stamp_ns=stamp_ns, width_px=8, height_px=6, frame_id=name
                )
                messages.append(message(f"/{name}/camera_info", "sensor_msgs/msg/CameraInfo", info, stamp_ns))
            if taken(name, step):
                taken_image = image(pixels, stamp_ns=stamp_ns, frame_id=name)
                messages.append(message(f"/{name}/image_raw", "sensor_msgs/msg/Image", taken_image, stamp_ns))
    return messages


def message(topic: str, msgtype: str, fields: Mapping[str, Any], stamp_ns: int) -> RawMessage:
    return raw(topic, msgtype, fields, stamp_ns, encoding="ros1")


def poorly(sensor: str, step: int) -> bool:
    """One camera dies at 1 s, one begins there, one has half the rate, one pauses for 1 s; a lidar dies at 2 s."""
    return {
        "cam1": step <= 10,
        "cam2": step >= 10,
        "cam3": step % 2 == 0,
        "cam4": not 10 < step < 20,
        "front": step < 20,
    }.get(sensor, True)


def test_every_frame_is_there_and_what_it_lacks_is_told(lidcam: Lidcam, tmp_path: Path) -> None:
    write_rosbag1(poor := tmp_path / "poor.bag", recorded(poorly))
    run = lidcam("process", poor, tmp_path / "out.mcap", "--json", "--set", CLUSTERS)
    assert run.code == 0, run.err
    report = json.loads(run.out)
    assert report["frames"] == 30
    assert not report["drops"]
    told = {sensor["sensor"]: (sensor["frames"], sensor["silences"]) for sensor in report["missing"]}
    assert told == {
        "front": (10, [{"start_s": 1.9, "end_s": None, "frames": 10}]),
        "cam1": (19, [{"start_s": 1.0, "end_s": None, "frames": 19}]),
        "cam2": (10, [{"start_s": None, "end_s": 1.0, "frames": 10}]),
        "cam3": (15, []),
        "cam4": (9, [{"start_s": 1.0, "end_s": 2.0, "frames": 9}]),
    }
    warned = {one["subject"] for one in report["warnings"] if "silent" in one["finding"]}
    assert warned == {"front", "cam1", "cam2", "cam4"}


def with_stamps(
    messages: list[RawMessage], topic: str, shift_ns: int, *, begin_s: float | None = None, late_ns: int = 0
) -> list[RawMessage]:
    """Messages of a topic stamped otherwise: shifted, or beginning with stamp 0 and going on from some seconds on.

    They are recorded so much later.
    """
    changed, last_ns = [], 0
    for one in messages:
        if one.topic == topic:
            stamp_ns = one.stamp_ns + shift_ns
            if begin_s is not None:
                stamp_ns = round(begin_s * 1e9) + one.stamp_ns - START_NS if last_ns else 0
            data = bytes(one.data)  # stamp behind the sequence number
            stamp = struct.pack("<II", *divmod(stamp_ns, 10**9))
            last_ns, log_ns = one.stamp_ns, one.log_time_ns + late_ns
            one = one._replace(stamp_ns=stamp_ns, log_time_ns=log_ns, data=data[:4] + stamp + data[12:])
        changed.append(one)
    return sorted(changed, key=lambda one: one.log_time_ns)


@pytest.mark.parametrize(
    ("steps", "change", "line"),
    [
        (3, {}, ""),
        (3, {"topic": "/cam1/image_raw", "shift_ns": -MINUTE_NS}, ""),  # a clock that was not set
        (30, {"topic": "/cam1/image_raw", "shift_ns": MINUTE_NS}, ""),
        (3, {"topic": "/cam1/image_raw", **LATER}, "cam1 is in no frame with the others"),
        (2, {"topic": "/cam1/image_raw", **LATER}, ""),  # by chance
        (12, {"topic": "/rear/points", **LATER}, "rear is in no frame with the others"),
        (12, {"topic": "/front/points", "shift_ns": 0, "begin_s": 0.0}, ""),
        (12, {"topic": "/front/points", "shift_ns": 0, "begin_s": 77.0}, ""),
    ],
)
def test_inspect_and_process_judge_alike(
    lidcam: Lidcam, tmp_path: Path, steps: int, change: dict[str, Any], line: str
) -> None:
    messages = recorded(lambda _, step: step < steps)
    write_rosbag1(tmp_path / "in.bag", with_stamps(messages, **change) if change else messages)
    codes, lines = [], []
    for command in (["inspect"], ["process"]):
        out = [tmp_path / "out.mcap", "--set", CLUSTERS] if command == ["process"] else []
        run = lidcam(*command, tmp_path / "in.bag", *out, "--json")
        codes.append(run.code)
        lines.append("; ".join(json.loads(run.out)["incomplete"]))
    assert codes == [3 if line else 0] * 2
    assert lines == [line] * 2
