"""Damaged recordings: what can still be read is read, the rest is told, and `--repair` writes what was saved."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import pointcloud2, raw, write_mcap, write_rosbag1, write_rosbag2
from command import Lidcam
from helpers import CLUSTERS
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lidcam.pipeline.core.messages import RawMessage

STEP_NS = 100_000_000
CLOUD = "sensor_msgs/msg/PointCloud2"


def clouds(encoding: Any) -> list[RawMessage]:
    noise = np.random.default_rng(0)
    messages = []
    for i in range(8):
        points = noise.uniform([5, -5, -1], [15, 5, 1], (200, 3)).astype(np.float32)
        cloud = pointcloud2(points, stamp_ns=i * STEP_NS + 1, frame_id="lidar")
        messages.append(raw("/points", CLOUD, cloud, i * STEP_NS + 1, i * STEP_NS + 5, encoding=encoding))
    return messages


def damaged(folder: Path, kind: str) -> Path:
    """Eight clouds in chunks of their own, a byte of the fourth overwritten where that shows, then cut off."""
    messages = clouds("ros1" if kind == "bag" else "cdr")
    if kind == "bag":
        path = folder / "rec.bag"
        write_rosbag1(path, messages, "bz2", chunk_bytes=1000)
    elif kind == "mcap":
        path = folder / "rec.mcap"
        write_mcap(path, messages, "none", chunk_bytes=1000)
    else:
        write_rosbag2(folder / "rec", messages)
        path = folder / "rec" / "rec.db3"
        path.write_bytes(path.read_bytes()[: -2 * 4096])
        return path
    content = bytearray(path.read_bytes())
    if kind == "bag":
        content[int(len(content) * 0.4)] ^= 1
    else:
        content[content.index(bytes(messages[3].data)) + 500] ^= 1
    path.write_bytes(content[:-30])
    return path


def judged(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and bytes by the MCAP library, which checks the checksums; all of them decode to whole clouds."""
    found = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            is_ros1 = channel.message_encoding == "ros1"
            assert (schema.name, schema.encoding) == (
                ("sensor_msgs/PointCloud2", "ros1msg") if is_ros1 else (CLOUD, "ros2msg")
            )
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(schema.data.decode(), CLOUD))
            decode = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
            cloud: Any = decode(message.data, CLOUD)
            assert cloud.width == 200
            found.append((channel.topic, message.log_time, message.data))
    return found


@pytest.mark.parametrize("kind", ["bag", "sqlite"])
def test_repair_writes_what_can_be_read(lidcam: Lidcam, tmp_path: Path, kind: str) -> None:
    path = damaged(tmp_path, kind)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    out, again = tmp_path / "out.mcap", tmp_path / "again.mcap"
    run = lidcam("inspect", path, "--repair", out)
    assert run.code == 3, run.err
    assert "messages lost" in run.out
    whole = {(m.topic, m.log_time_ns, bytes(m.data)) for m in clouds("ros1" if kind == "bag" else "cdr")}
    saved = judged(out)
    assert set(saved) < whole
    assert len(saved) == (7 if kind == "bag" else len(saved)) >= 4
    assert f"wrote {out}: {len(saved)} messages" in run.err.replace("\n", " ")
    assert lidcam("inspect", path, "--repair", again).code == 3
    assert again.read_bytes() == out.read_bytes()
    assert {file: file.read_bytes() for file in before} == before
    tree = json.loads(lidcam("inspect", out, "--json").out)
    assert (tree["losses"], tree["messages"]) == ([], len(saved))


def test_a_file_that_was_not_closed_and_lost_nothing_is_whole(lidcam: Lidcam, tmp_path: Path) -> None:
    path, out = tmp_path / "rec.mcap", tmp_path / "out.mcap"
    write_mcap(path, clouds("cdr"))
    path.write_bytes(path.read_bytes()[:-8])  # of what stands after the messages
    run = lidcam("process", path, out, "--set", CLUSTERS)
    assert run.code == 0, run.err
    assert "is damaged or was not closed" in run.err
    run = lidcam("inspect", path, "--repair", tmp_path / "whole.mcap")
    assert run.code == 0, run.err
    assert run.out.splitlines()[1] == "verdict: every message was copied"
    assert len(judged(tmp_path / "whole.mcap")) == len(clouds("cdr"))


def test_process_tells_what_was_lost(lidcam: Lidcam, tmp_path: Path) -> None:
    path, out = damaged(tmp_path, "mcap"), tmp_path / "out.mcap"
    run = lidcam("process", path, out, "--set", CLUSTERS, "-v")
    assert run.code == 3, run.err
    assert "rec.mcap is damaged or was not closed" in run.err
    assert "crc" in run.out
    tree = json.loads(lidcam("process", path, out, "--json", "--set", CLUSTERS).out)
    assert tree["frames"] == 7
    assert (tree["exit_code"], tree["failure"], len(tree["incomplete"])) == (3, "", 1)
    assert run.err.splitlines()[-1] == f"lidcam: incomplete: {tree['incomplete'][0]}; exit code 3"
    assert tree["incomplete"][0].startswith(f"{path}: damaged, ")
    (chunk, tail) = tree["losses"]
    assert (chunk["file"], chunk["messages"], tail["messages"]) == (str(path), 1, 0)
    assert chunk["size"] > 2400
    run = lidcam("process", path, tmp_path / "no.mcap", "--on-bad-message", "fail")
    assert run.code == 1
    assert "damaged or was not closed" in run.error_line
    assert not list(tmp_path.glob("no*"))


def test_nothing_to_save_and_never_over_the_recording(lidcam: Lidcam, tmp_path: Path) -> None:
    path = tmp_path / "rec.bag"
    path.write_bytes(b"#ROSBAG V2.0\n")
    run = lidcam("inspect", path, "--repair", tmp_path / "out.mcap")
    assert run.code == 1
    assert "copy it again" in run.error_line
    write_mcap(whole := tmp_path / "rec.mcap", clouds("cdr"))
    content = whole.read_bytes()
    assert lidcam("inspect", whole, "--repair", whole).code == 1
    assert whole.read_bytes() == content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rec.bag", "rec.mcap"]
