"""The kinds of a lidar's data: the same objects from clouds in every form; an Ouster's packets in every container."""

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from builders import in_order, raw, write_mcap, write_rosbag1
from captures import fragments, ip_packet, pcap
from command import Lidcam
from helpers import CLUSTERS
from ouster_packets import START_NS, TURN_NS, drive, frame, metadata, needs_sdk, packets
from results import fused_objects, messages_of

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2

COMPRESSED = "point_cloud_interfaces/msg/CompressedPointCloud2"


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
        packed = np.frombuffer(gzip.compress(data) if form == "zlib" else zstandard.compress(data), np.uint8)
        msgtype = COMPRESSED
        fields = {**{name: getattr(cloud, name) for name in names}, "format": form, "compressed_data": packed}
    return raw(message.topic, msgtype, fields, message.stamp_ns, message.log_time_ns, message.channel.encoding)  # type: ignore[arg-type]


@pytest.mark.parametrize("form", ["PointCloud", "zlib", "zstd"])
def test_objects_are_the_same_from_clouds_in_every_form(
    form: str, first_messages: dict[str, list[RawMessage]], first_result: Path, lidcam: Lidcam, tmp_path: Path
) -> None:
    changed = {
        topic: [in_form(form, one) if one.channel.msgtype == "sensor_msgs/msg/PointCloud2" else one for one in messages]
        for topic, messages in first_messages.items()
    }
    write_rosbag1(tmp_path / "in.bag", in_order(*changed.values()))
    run = lidcam("process", tmp_path / "in.bag", tmp_path / "out.mcap", "--config", "sandbox", "--set", CLUSTERS)
    assert run.code == 0, run.err
    assert fused_objects(tmp_path / "out.mcap") == fused_objects(first_result)


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
