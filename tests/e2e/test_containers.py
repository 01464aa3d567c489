"""The sample recording in other forms gives the same fused objects."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from builders import image, raw, write_mcap, write_rosbag1
from combined_messages import CAMERAS, CLOUDS, combined
from command import Lidcam
from foxglove_messages import twin
from results import Found, fused_objects, messages_of, topics_of

from pipeline.core.messages import RawMessage
from readers.messages.deserialize import deserialize
from readers.open import open_recording

FRAMES = 6
CLOUD_TOPICS = [f"/velodyne{i}_points" for i in (1, 2, 3)]
NUMBERS = (11, 12, 13, 14, 41, 42, 43, 44)
IMAGE_TOPICS = [f"/image_raw_{i}/compressed" for i in NUMBERS]

Objects = dict[int, list[Found]]
Process = Callable[[Path], tuple[Objects, Path]]


@pytest.fixture(scope="module")
def sensors(sandbox: Path) -> dict[str, list[RawMessage]]:
    """The first messages of each topic: as many of each sensor."""
    by_topic: defaultdict[str, list[RawMessage]] = defaultdict(list)
    with open_recording([sandbox]) as recording:
        for info in recording.topics:
            if "base_pose" not in info.topic:
                by_topic[info.topic] += islice(recording.messages([info.topic]), FRAMES)
    return by_topic


@pytest.fixture(scope="module")
def process(lidcam: Lidcam, sandbox_config: Path) -> Process:
    def run(recording: Path) -> tuple[Objects, Path]:
        out = recording.with_suffix(".out.mcap")
        done = lidcam("process", recording, out, "--config", sandbox_config)
        assert done.code == 0, done.err
        return fused_objects(out), out

    return run


@pytest.fixture(scope="module")
def expected(
    sensors: dict[str, list[RawMessage]], process: Process, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Objects, Path]:
    path = tmp_path_factory.mktemp("plain") / "plain.bag"
    write_rosbag1(path, in_order(message for topic in sensors.values() for message in topic))
    objects, out = process(path)
    assert len(objects) >= FRAMES - 1
    assert sum(map(len, objects.values())) >= 2 * FRAMES - 4
    return objects, out


def in_order(messages: Iterable[RawMessage]) -> list[RawMessage]:
    return sorted(messages, key=lambda message: (message.log_time_ns, message.topic))


def decompressed(message: RawMessage) -> RawMessage:
    """The Image that the predecessor's combined messages hold."""
    image_message: Any = deserialize(message)
    pixels = cv2.imdecode(image_message.data, cv2.IMREAD_COLOR)
    assert pixels is not None
    fields = image(
        np.asarray(pixels, np.uint8), stamp_ns=message.stamp_ns, frame_id=image_message.header.frame_id, encoding="bgr8"
    )
    return raw(message.topic, "sensor_msgs/msg/Image", fields, message.stamp_ns, message.log_time_ns, "ros1")


def original(sensors: dict[str, list[RawMessage]]) -> list[RawMessage]:
    """The recording as the predecessor's listeners combine it; stamps and log times are those of combining."""
    messages = [m for topic, all_ in sensors.items() if topic not in {*CLOUD_TOPICS, *IMAGE_TOPICS} for m in all_]
    for clouds in zip(*(sensors[topic] for topic in CLOUD_TOPICS), strict=True):
        now_ns = max(m.log_time_ns for m in clouds) + 7_000_000
        messages.append(combined("/pointcloud_list", CLOUDS, clouds, now_ns, "ros1"))
    for images in zip(*(sensors[topic] for topic in IMAGE_TOPICS), strict=True):
        now_ns = max(m.log_time_ns for m in images) + 9_000_000
        parts = [decompressed(m) for m in images]
        messages.append(combined("/camera_msgs_combined", CAMERAS, parts, now_ns, "ros1"))
    return in_order(messages)


def test_combined_messages_of_the_original(
    sensors: dict[str, list[RawMessage]], expected: tuple[Objects, Path], process: Process, tmp_path: Path
) -> None:
    path = tmp_path / "original.bag"
    write_rosbag1(path, original(sensors), "lz4")
    objects, out = process(path)
    assert objects == expected[0]
    assert topics_of(out)["/cam1/image"][0] == "sensor_msgs/msg/Image"
    images = [message for _, message in messages_of(out, "/cam8/image")]
    recorded = [decompressed(m) for m in sensors[IMAGE_TOPICS[-1]]]
    stamps = {(s.stamp_ns // 10**9, s.stamp_ns % 10**9): deserialize(s).data for s in recorded}
    assert len(images) == len(objects)
    assert all(np.array_equal(p.data, stamps[p.header.stamp.sec, p.header.stamp.nanosec]) for p in images)


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_foxglove_schemas(
    sensors: dict[str, list[RawMessage]],
    expected: tuple[Objects, Path],
    process: Process,
    tmp_path: Path,
    encoding: Any,
) -> None:
    """Clouds, images, calibration and transforms in Foxglove's schemas beside recorded boxes of ROS 1."""
    path = tmp_path / f"{encoding}.mcap"
    twins = [twin(message, encoding) for topic in sensors.values() for message in topic]
    assert {m.channel.encoding for m in twins} == {encoding, "ros1"}
    write_mcap(path, in_order(twins), "zstd", profile="")
    objects, out = process(path)
    assert objects == expected[0]
    for topic in ("/cam11/image/compressed", "/cam44/image/compressed"):
        images, known = (
            [(log, m.header.stamp, m.header.frame_id, m.format, m.data.tobytes()) for log, m in messages_of(p, topic)]
            for p in (out, expected[1])
        )
        assert repr(images) == repr(known)


def test_ros1_messages_in_an_mcap(
    sensors: dict[str, list[RawMessage]], expected: tuple[Objects, Path], process: Process, tmp_path: Path
) -> None:
    path = tmp_path / "ros1.mcap"
    messages = in_order(message for topic in sensors.values() for message in topic)
    write_mcap(path, messages, "lz4", profile="ros1")
    assert process(path)[0] == expected[0]


def test_only_the_combined_cloud(expected: tuple[Objects, Path], process: Process, tmp_path: Path) -> None:
    """The output of one run has no other cloud than the combined one: as input it shows the same cars."""
    path = tmp_path / "again.mcap"
    path.write_bytes(expected[1].read_bytes())
    objects, _ = process(path)
    assert objects.keys() == expected[0].keys()
    distances_m = [
        min((np.hypot(found.x - known.x, found.y - known.y) for found in objects[stamp_ns]), default=np.inf)
        for stamp_ns, all_known in expected[0].items()
        for known in all_known
        if known.score > 0.5  # without ground, what is no car looks another way
    ]
    assert np.mean(np.array(distances_m) < 0.05) > 0.8


def test_inspect_lists_the_parts(sensors: dict[str, list[RawMessage]], lidcam: Lidcam, tmp_path: Path) -> None:
    path = tmp_path / "original.bag"
    write_rosbag1(path, original(sensors))
    done = lidcam("inspect", path, "--json")
    assert done.code == 0, done.err
    topics = {topic["topic"]: topic for topic in json.loads(done.out)["topics"]}
    for name, kind in (("/camera_msgs_combined/camera_8", "Image"), ("/pointcloud_list/pointcloud_3", "PointCloud2")):
        assert topics[name]["msgtype"] == f"sensor_msgs/msg/{kind}"
        assert topics[name]["rate_hz"] == pytest.approx(10, rel=0.05)
