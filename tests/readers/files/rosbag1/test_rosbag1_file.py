"""Against the genuine rosbag library: what it read from the same files is recorded in the manifest."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from builders import odometry, raw, write_rosbag1
from helpers import shared

from lidcam.readers.open import open_recording

SOUND = [
    *(f"seed_{kind}.bag" for kind in ("none", "none_chunky", "bz2", "bz2_chunky", "lz4", "lz4_chunky")),
    "empty.bag",
    "unsorted_py.bag",
    "two_conns_cpp.bag",
    "corrupt_none_middle.bag",  # format 2.0 has no checksums: the genuine library reads it too
]
DAMAGED = [
    *("killed_none.bag", "killed_lz4.bag", "cut_lz4_60pct.bag", "cut_none_60pct.bag", "cut_none_lastbyte.bag"),
    *("cut_header.bag", "cut_magic_only.bag", "corrupt_lz4_middle.bag"),
]


def manifest() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(shared("oracles/genuine_bags/manifest.json").read_text())
    return loaded


def test_every_genuine_bag_is_judged() -> None:
    assert {*SOUND, *DAMAGED, "cut_empty.bag"} == manifest().keys()


@pytest.mark.parametrize("name", SOUND)
def test_same_messages_as_the_genuine_library(name: str) -> None:
    expected = [
        (topic, msgtype, time, size, md5)
        for topic, msgtype, _, time, size, md5 in sorted(manifest()[name]["list"], key=lambda row: int(row[3]))
    ]  # python rosbag leaves messages out of order across chunks; C++ rosbag::View sorts, as we do
    with open_recording([shared(f"oracles/genuine_bags/{name}")]) as recording:
        got = [
            (
                m.topic,
                m.channel.msgtype.replace("/msg/", "/"),
                m.log_time_ns,
                len(m.data),
                hashlib.md5(m.data).hexdigest(),
            )
            for m in recording.messages()
        ]
        assert recording.message_count == len(got)
    assert got == expected


def test_two_connections_in_the_order_of_the_cpp_library() -> None:
    cpp = json.loads(shared("oracles/genuine_bags/two_conns_cpp.json").read_text())
    with open_recording([shared("oracles/genuine_bags/two_conns_cpp.bag")]) as recording:
        assert [m.log_time_ns for m in recording.messages()] == [time for time, _, _ in cpp["cpp_view_order"]]
        assert (recording.start_ns, recording.end_ns) == (cpp["begin"], cpp["end"])
        assert [t.message_count for t in recording.topics] == [7]


def test_chunks_that_overlap_are_not_all_kept(tmp_path: Path) -> None:
    """Written backwards in time: every chunk is needed again and again in a merge, none of them is held twice."""
    path = tmp_path / "backwards.bag"
    stamps = [(i * 7919) % 997 for i in range(300)]
    messages = [raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=t), t, 10**9 + t, "ros1") for t in stamps]
    write_rosbag1(path, messages, "lz4", chunk_bytes=3000)
    with open_recording([path]) as recording:
        got = [m.stamp_ns for m in recording.messages()]
    assert got == sorted(stamps)
