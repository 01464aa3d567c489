"""The sample recording in other types of messages gives the same fused objects."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from builders import image, in_order, raw, write_rosbag1
from combined_messages import CAMERAS, CLOUDS, combined
from command import Lidcam
from helpers import CLUSTERS
from results import Found, fused_objects, messages_of, stamp_of, topics_of

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize

CLOUD_TOPICS = [f"/velodyne{i}_points" for i in (1, 2, 3)]
NUMBERS = (11, 12, 13, 14, 41, 42, 43, 44)
IMAGE_TOPICS = [f"/image_raw_{i}/compressed" for i in NUMBERS]

Objects = dict[int, list[Found]]
Sensors = dict[str, list[RawMessage]]
Process = Callable[[Path], tuple[Objects, Path]]


@pytest.fixture(scope="module")
def process(lidcam: Lidcam) -> Process:
    def run(recording: Path) -> tuple[Objects, Path]:
        out = recording.with_suffix(".out.mcap")
        done = lidcam("process", recording, out, "--config", "sandbox", "--set", CLUSTERS)
        assert done.code == 0, done.err
        return fused_objects(out), out

    return run


@pytest.fixture(scope="module")
def expected(first_result: Path) -> tuple[Objects, Path]:
    return fused_objects(first_result), first_result


def decompressed(message: RawMessage) -> RawMessage:
    """The Image that the predecessor's combined messages hold."""
    image_message: Any = deserialize(message)
    pixels = cv2.imdecode(image_message.data, cv2.IMREAD_COLOR)
    assert pixels is not None
    fields = image(
        np.asarray(pixels, np.uint8), stamp_ns=message.stamp_ns, frame_id=image_message.header.frame_id, encoding="bgr8"
    )
    return raw(message.topic, "sensor_msgs/msg/Image", fields, message.stamp_ns, message.log_time_ns, "ros1")


def original(first_messages: Sensors) -> list[RawMessage]:
    """The recording as the predecessor's listeners combine it; stamps and log times are those of combining."""
    messages = [
        m for topic, all_ in first_messages.items() if topic not in {*CLOUD_TOPICS, *IMAGE_TOPICS} for m in all_
    ]
    for clouds in zip(*(first_messages[topic] for topic in CLOUD_TOPICS), strict=True):
        now_ns = max(m.log_time_ns for m in clouds) + 7_000_000
        messages.append(combined("/pointcloud_list", CLOUDS, clouds, now_ns, "ros1"))
    for images in zip(*(first_messages[topic] for topic in IMAGE_TOPICS), strict=True):
        now_ns = max(m.log_time_ns for m in images) + 9_000_000
        parts = [decompressed(m) for m in images]
        messages.append(combined("/camera_msgs_combined", CAMERAS, parts, now_ns, "ros1"))
    return in_order(messages)


def test_combined_messages_of_the_original(
    first_messages: Sensors, expected: tuple[Objects, Path], process: Process, tmp_path: Path
) -> None:
    path = tmp_path / "original.bag"
    write_rosbag1(path, original(first_messages), "lz4")
    objects, out = process(path)
    assert objects == expected[0]
    assert topics_of(out)["/cam1/image"][0] == "sensor_msgs/msg/Image"
    images = [message for _, message in messages_of(out, "/cam8/image")]
    recorded = [decompressed(m) for m in first_messages[IMAGE_TOPICS[-1]]]
    pixels = {message.stamp_ns: deserialize(message).data for message in recorded}
    assert len(images) == len(objects)
    assert all(np.array_equal(one.data, pixels[stamp_of(one)]) for one in images)
