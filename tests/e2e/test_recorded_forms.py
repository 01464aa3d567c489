"""The same objects from a recording in every form; an Ouster's packets in every container."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from builders import image, in_order, raw, write_mcap, write_rosbag1
from captures import fragments, ip_packet, pcap
from combined_messages import CAMERAS, CLOUDS, combined
from command import Lidcam
from helpers import CLUSTERS
from ouster_packets import START_NS, TURN_NS, drive, frame, metadata, needs_sdk, packets
from results import fused_objects, messages_of, topics_of

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2

pytestmark = pytest.mark.slow

Sensors = dict[str, list[RawMessage]]


def in_form(form: str, message: RawMessage) -> RawMessage:
    """The cloud of a message in another form."""
    cloud: Any = deserialize(message)
    if form == "PointCloud":
        points = decode_pointcloud2(message)
        numbers: dict[str, Array] = {
            "intensity": points.intensity,
            "ring": points.ring,
            "time": points.time_offset_ns / 1e9,
        }
        channels = [{"name": name, "values": values.astype(np.float32)} for name, values in numbers.items()]
        xyz = [dict(zip("xyz", point, strict=True)) for point in points.xyz.tolist()]
        msgtype, fields = "sensor_msgs/msg/PointCloud", {"header": cloud.header, "points": xyz, "channels": channels}
    else:
        names = ("header", "height", "width", "fields", "is_bigendian", "point_step", "row_step", "is_dense")
        data = cloud.data.tobytes()
        packed = np.frombuffer(zstandard.compress(data), np.uint8)
        msgtype = "point_cloud_interfaces/msg/CompressedPointCloud2"
        fields = {**{name: getattr(cloud, name) for name in names}, "format": form, "compressed_data": packed}
    return raw(message.topic, msgtype, fields, message.stamp_ns, message.log_time_ns, message.channel.encoding)  # type: ignore[arg-type]


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


@pytest.mark.parametrize("form", ["PointCloud", "zstd", "lists"])
def test_objects_are_the_same_from_every_form(
    form: str, first_messages: Sensors, first_result: Path, lidcam: Lidcam, tmp_path: Path
) -> None:
    changed = {
        topic: [in_form(form, one) if one.channel.msgtype == "sensor_msgs/msg/PointCloud2" else one for one in messages]
        for topic, messages in first_messages.items()
        if form != "lists"
    }
    write_rosbag1(tmp_path / "in.bag", in_order(*changed.values()) if changed else in_lists(first_messages), "lz4")
    run = lidcam("process", tmp_path / "in.bag", tmp_path / "out.mcap", "--config", "sandbox", "--set", CLUSTERS)
    assert run.code == 0, run.err
    assert fused_objects(tmp_path / "out.mcap") == fused_objects(first_result)
    assert form != "lists" or topics_of(tmp_path / "out.mcap")["/cam1/image"][0] == "sensor_msgs/msg/Image"


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
