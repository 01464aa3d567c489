"""The same objects from a predecessor's recording; an Ouster's packets in every container."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from builders import image, in_order, raw, write_mcap, write_rosbag1
from captures import fragments, ip_packet, pcap
from combined_messages import CAMERAS, CLOUDS, combined
from command import Lidcam
from helpers import CLUSTERS
from ouster_packets import START_NS, TURN_NS, drive, frame, metadata, needs_sdk, packets
from results import fused_objects, messages_of, topics_of

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize

pytestmark = pytest.mark.slow

Sensors = dict[str, list[RawMessage]]


def decompressed(message: RawMessage) -> RawMessage:
    """The Image that the predecessor's combined messages hold."""
    shown: Any = deserialize(message)
    pixels = np.asarray(cv2.imdecode(shown.data, cv2.IMREAD_COLOR), np.uint8)
    fields = image(pixels, stamp_ns=message.stamp_ns, frame_id=shown.header.frame_id, encoding="bgr8")
    return raw(message.topic, "sensor_msgs/msg/Image", fields, message.stamp_ns, message.log_time_ns, "ros1")


def in_lists(messages: Sensors) -> list[RawMessage]:
    """As the predecessor's listeners combine them; stamps and log times are those of combining."""
    clouds = [topic for topic in messages if topic.endswith("_points")]
    images = [topic for topic in messages if topic.startswith("/image_raw")]
    made = [one for topic, all_ in messages.items() if topic not in {*clouds, *images} for one in all_]
    for topic, kind, topics in (("/pointcloud_list", CLOUDS, clouds), ("/camera_msgs_combined", CAMERAS, images)):
        for parts in zip(*(messages[one] for one in topics), strict=True):
            held = parts if kind == CLOUDS else [*map(decompressed, parts)]
            made.append(combined(topic, kind, held, max(one.log_time_ns for one in parts) + 8_000_000, "ros1"))
    return in_order(made)


def test_objects_are_the_same_from_combined_messages(
    first_messages: Sensors, first_result: Path, lidcam: Lidcam, tmp_path: Path
) -> None:
    write_rosbag1(tmp_path / "in.bag", in_lists(first_messages), "lz4")
    run = lidcam("process", tmp_path / "in.bag", tmp_path / "out.mcap", "--config", "sandbox", "--set", CLUSTERS)
    assert run.code == 0, run.err
    assert fused_objects(tmp_path / "out.mcap") == fused_objects(first_result)
    assert topics_of(tmp_path / "out.mcap")["/cam1/image"][0] == "sensor_msgs/msg/Image"


@needs_sdk
@pytest.mark.parametrize("container", ["mcap", "bag", "pcap"])
def test_packets_of_an_ouster(container: str, lidcam: Lidcam, tmp_path: Path) -> None:
    text, path = metadata(), tmp_path / f"drive.{container}"
    if container == "mcap":
        write_mcap(path, drive(text))
    elif container == "bag":
        write_rosbag1(path, drive(text, package="ouster_ros", encoding="ros1"))
    else:
        sent = [one for turn in range(3) for one in packets(text, frame(text, turn))]
        step_ns = TURN_NS // 64
        frames = [fragments(ip_packet(data, "10.0.0.1", 7502, id=number)) for number, data in enumerate(sent)]
        timed = [(START_NS + number * step_ns, part) for number, parts in enumerate(frames) for part in parts]
        path.write_bytes(pcap(timed))
        path.with_suffix(".json").write_text(text)
    quick = ("detect3d.method=none", "combine.outliers.enabled=false", "combine.ground.enabled=false")
    options = [part for setting in quick for part in ("--set", setting)]
    run = lidcam("process", path, tmp_path / "out.mcap", "--json", *options)
    assert run.code == 0, run.err
    topic = "/ouster_10_0_0_1/lidar_packets" if container == "pcap" else "/ouster/lidar_packets"
    assert json.loads(run.out)["messages_used"] == {topic: 3}
    clouds = [cloud for _, cloud in messages_of(tmp_path / "out.mcap", "/point_cloud_combined")]
    assert [cloud.header.frame_id for cloud in clouds] == ["os_lidar"] * 3
    assert all(cloud.width > 40_000 for cloud in clouds)
    inspected = json.loads(lidcam("inspect", path, "--json").out)
    assert [(one["topic"], one["count"]) for one in inspected["topics"] if "packets" in one["topic"]] == [(topic, 3)]
