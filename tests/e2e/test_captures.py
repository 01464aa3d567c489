"""A capture of a Velodyne's packets is an input of its own, and so is the MCAP that is made of a damaged one."""

import json
from pathlib import Path

import numpy as np
from captures import capture_of, pcap
from command import Lidcam
from results import messages_of, topics_of
from velodyne import random_packets

TOPIC = "/velodyne_10_0_0_1/packets"


def test_a_cut_capture_is_read_and_written_as_an_mcap(lidcam: Lidcam, tmp_path: Path) -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=170, start=0)
    cut, whole, out = (tmp_path / name for name in ("cut.pcap", "whole.mcap", "out.mcap"))
    cut.write_bytes(pcap(capture_of(payload, stamps_ns, "10.0.0.1"))[:-7])
    inspected = lidcam("inspect", cut, "--repair", whole)
    assert "a packet is cut off: expected 1248 bytes, found 1241" in inspected.out
    assert inspected.err.splitlines()[-1] == f"lidcam: incomplete: {cut}: damaged, 1 message lost; exit code 3"
    assert topics_of(whole) == {TOPIC: ("velodyne_msgs/msg/VelodynePacket", 169)}
    assert np.array_equal(np.stack([packet.data for _, packet in messages_of(whole, TOPIC)]), payload[:-1])
    settings = ("detect3d.method=none", "combine.outliers.enabled=false", "combine.ground.enabled=false")
    run = lidcam("process", cut, out, "--json", *(part for one in settings for part in ("--set", one)))
    assert (run.code, json.loads(run.out)["messages_used"]) == (3, {TOPIC: 3})
    sweeps = messages_of(out, "/point_cloud_combined")
    assert [cloud.header.frame_id for _, cloud in sweeps] == ["velodyne_10_0_0_1"] * 3
