"""Captures of Velodynes' packets as inputs of their own, and packets that cannot be used."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from captures import capture_of, ethernet, ip_packet, pcap
from logging_state import kept_logging
from results import fused_objects, messages_of, topics_of
from velodyne import START_NS, random_packets

from lidcam.cli.inspect import inspect
from lidcam.cli.process import run_process
from lidcam.pipeline.core.errors import ConfigError, IncompleteError, RecordingError
from lidcam.run.job import make_job

PAYLOAD, STAMPS_NS = random_packets("VLP-16", packets=170, start=0)
TOPIC = "/velodyne_10_0_0_1/packets"
FAST = ("detect3d.method=none", "combine.outliers.enabled=false", "combine.ground.enabled=false")
"""Points at random are long looked at, and none is an object."""


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    one = capture_of(PAYLOAD, STAMPS_NS, "10.0.0.1")
    gps = [(START_NS + n * 10**8, ethernet(ip_packet(bytes(512), "10.0.0.1", 8308))) for n in range(2)]
    (folder / "one.pcap").write_bytes(pcap(sorted([*one, *gps], key=lambda packet: packet[0])))
    (folder / "cut.pcap").write_bytes(pcap(one)[:-7])
    return folder


def processed(capsys: pytest.CaptureFixture[str], *inputs: Path, out: Path, **options: Any) -> Any:
    """The final table of `lidcam process`, called here: to start a program takes longer."""
    with suppress(IncompleteError):
        run_process(make_job(inputs, out, **{"settings": FAST, **options}), as_json=True)
    return json.loads(capsys.readouterr().out)


def test_one_lidar_needs_nothing_else(captures: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = processed(capsys, captures / "one.pcap", out=(out := tmp_path / "out.mcap"))
    assert table["messages_used"] == {TOPIC: 3}
    assert table["unused_topics"] == {"/other_traffic/position": 2}
    assert (table["losses"], table["exit_code"]) == ([], 0)
    sweeps = messages_of(out, "/point_cloud_combined")
    assert [cloud.header.frame_id for _, cloud in sweeps] == ["velodyne_10_0_0_1"] * 3
    assert next(iter(fused_objects(out))) == START_NS
    with kept_logging():
        inspect([str(captures / "one.pcap")], as_json=True)
    topics = {topic["topic"]: topic for topic in json.loads(capsys.readouterr().out)["topics"]}
    assert (topics[TOPIC]["msgtype"], topics[TOPIC]["count"]) == ("velodyne_msgs/msg/VelodyneScan", 3)
    assert "GPS" in topics["/other_traffic/position"]["problem"]
    with pytest.raises(ConfigError, match=r"HDL-64E S2 needs velodyne\.calibration"):
        processed(capsys, captures / "one.pcap", out=out, settings=("velodyne.model=HDL-64E S2",))


def test_a_cut_capture_is_read_and_written_as_an_mcap(
    captures: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole, out = tmp_path / "whole.mcap", tmp_path / "out.mcap"
    with kept_logging(), pytest.raises(IncompleteError, match="damaged, 1 message lost"):
        inspect([str(captures / "cut.pcap")], repair=whole)
    assert "a packet is cut off: expected 1248 bytes, found 1241" in capsys.readouterr().out
    assert topics_of(whole) == {TOPIC: ("velodyne_msgs/msg/VelodynePacket", 169)}
    found = messages_of(whole, TOPIC)
    assert np.array_equal(np.stack([packet.data for _, packet in found]), PAYLOAD[:-1])
    assert processed(capsys, whole, out=out, on_bad_message="fail")["messages_used"] == {TOPIC: 3}
    with pytest.raises(RecordingError, match="a packet is cut off"):
        processed(capsys, captures / "cut.pcap", out=out, on_bad_message="fail")
