"""Captures of Velodynes' packets as inputs of their own, and packets that cannot be used."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import write_rosbag1
from captures import capture_of, ethernet, ip_packet, pcap
from command import Lidcam
from logging_state import kept_logging
from results import fused_objects, messages_of, topics_of
from velodyne import START_NS, packet_stream, random_packets, scan

from lidcam.commands.inspect import inspect
from lidcam.commands.process import run_process
from lidcam.job import make_job
from pipeline.core.errors import CalibrationError, IncompleteError, MessageError, RecordingError

PAYLOAD, STAMPS_NS = random_packets("VLP-16", packets=170, start=0)
LEFT, RIGHT = "/velodyne_10_0_0_1/packets", "/velodyne_10_0_0_2/packets"
FAST = ("detect3d.method=none", "combine.outliers.enabled=false", "combine.ground.enabled=false")
"""Points at random are long looked at, and none is an object."""

FOREIGN = "packets with blocks that a VLP-16 does not send"


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    one = capture_of(PAYLOAD, STAMPS_NS, "10.0.0.1")
    gps = [(START_NS + n * 10**8, ethernet(ip_packet(bytes(554), "10.0.0.1", 8308))) for n in range(2)]
    (folder / "one.pcap").write_bytes(pcap(sorted([*one, *gps], key=lambda packet: packet[0])))
    (folder / "cut.pcap").write_bytes(pcap(one)[:-7])
    both = sorted([*one, *capture_of(PAYLOAD, STAMPS_NS, "10.0.0.2")], key=lambda packet: packet[0])
    (folder / "two.pcap").write_bytes(pcap(both))
    return folder


def processed(capsys: pytest.CaptureFixture[str], *inputs: Path, out: Path, **options: Any) -> Any:
    """The final table of `lidcam process`, called here: to start a program takes longer."""
    with suppress(IncompleteError):
        run_process(make_job(inputs, out, settings=FAST, **options), as_json=True)
    return json.loads(capsys.readouterr().out)


def test_one_lidar_needs_nothing_else(captures: Path, lidcam: Lidcam, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    run = lidcam("process", captures / "one.pcap", out, *(word for setting in FAST for word in ("--set", setting)))
    assert run.code == 0, run.err
    assert "/other_traffic/position (2: position packets (GPS), which are not used)" in run.out
    assert f"{LEFT}: 170 velodyne_msgs/msg/VelodynePacket gathered into sweeps" in run.out
    sweeps = messages_of(out, "/point_cloud_combined")
    assert len(sweeps) == 3
    assert {cloud.header.frame_id for _, cloud in sweeps} == {"velodyne_10_0_0_1"}
    assert next(iter(fused_objects(out))) == START_NS


def test_the_tables_for_machines(captures: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = processed(capsys, captures / "one.pcap", out=tmp_path / "out.mcap")
    assert table["messages_used"] == {LEFT: 3}
    assert table["unused_topics"] == {"/other_traffic/position": 2}
    assert (table["losses"], table["exit_code"]) == ([], 0)
    with kept_logging():
        inspect([str(captures / "one.pcap")], as_json=True)
    found = json.loads(capsys.readouterr().out)
    topics = {topic["topic"]: topic for topic in found["topics"]}
    assert (topics[LEFT]["msgtype"], topics[LEFT]["count"]) == ("velodyne_msgs/msg/VelodyneScan", 3)
    assert topics["/other_traffic/position"]["count"] == 2
    assert "GPS" in topics["/other_traffic/position"]["problem"]


def test_a_cut_capture_is_read_and_written_as_an_mcap(
    captures: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole, out = tmp_path / "whole.mcap", tmp_path / "out.mcap"
    with kept_logging(), pytest.raises(IncompleteError, match="damaged, 1 message lost"):
        inspect([str(captures / "cut.pcap")], repair=whole)
    assert "a packet is cut off: expected 1248 bytes, found 1241" in capsys.readouterr().out
    assert topics_of(whole) == {LEFT: ("velodyne_msgs/msg/VelodynePacket", 169)}
    found = messages_of(whole, LEFT)
    assert np.array_equal(np.stack([packet.data for _, packet in found]), PAYLOAD[:-1])
    assert processed(capsys, whole, out=out, on_bad_message="fail")["messages_used"] == {LEFT: 3}
    with pytest.raises(RecordingError, match="a packet is cut off"):
        processed(capsys, captures / "cut.pcap", out=out, on_bad_message="fail")


def test_several_lidars_need_their_poses(captures: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    with pytest.raises(CalibrationError) as caught:
        processed(capsys, captures / "two.pcap", out=out)
    assert f"found 2 lidars ({LEFT}, {RIGHT}) without poses" in str(caught.value)
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"site_frame: site\nlidars:\n  left: {{topic: {LEFT}, translation_m: [0, 1, 2]}}\n"
        f"  right: {{topic: {RIGHT}, translation_m: [0, -1, 2]}}\n"
    )
    assert processed(capsys, captures / "two.pcap", out=out, rig=rig)["messages_used"] == {LEFT: 3, RIGHT: 3}


@pytest.mark.parametrize("kind", ["scan", "packets"])
def test_packets_that_cannot_be_used_are_in_the_table(
    kind: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    foreign = PAYLOAD[:70].copy()
    foreign[[3, 30]] = 0x55
    foreign[40, 200] = 0
    stamps_ns = STAMPS_NS[:70]
    if kind == "scan":
        messages = [scan(foreign, stamps_ns, encoding="ros1")]
    else:
        messages = packet_stream(foreign, stamps_ns, encoding="ros1")
        messages[50] = messages[50]._replace(data=messages[50].data[:1000])
    path, out = tmp_path / "foreign.bag", tmp_path / "out.mcap"
    write_rosbag1(path, messages)
    table = processed(capsys, path, out=out)
    assert table["messages_used"] == {"/velodyne_packets": 1}
    counts = {drop["reason"]: drop["count"] for drop in table["drops"]}
    assert table["exit_code"] == 3
    assert counts == {FOREIGN: 3} | ({"packets that cannot be decoded": 1} if kind == "packets" else {})
    with pytest.raises(MessageError, match="3 of 70 packets of the scan" if kind == "scan" else "found 1000 bytes"):
        processed(capsys, path, out=out, on_bad_message="fail")
