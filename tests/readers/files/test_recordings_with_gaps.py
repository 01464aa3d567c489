"""Recordings that lack what others have: definitions, metadata.yaml, the serialization format."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from builders import detection2d_array, odometry, raw, store_for, write_rosbag1, write_rosbag2

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording

T0 = 1_700_000_000 * 10**9
ODOMETRY, BOXES = "nav_msgs/msg/Odometry", "vision_msgs/msg/Detection2DArray"
Storage = Literal["sqlite3", "mcap"]
Compression = Literal["none", "file", "message", "storage"]


def recorded() -> list[RawMessage]:
    messages = []
    for i in range(20):
        stamp = T0 + i * 10**8
        boxes = detection2d_array([[1, 2, 3, 4]] * i, class_names=["car"] * i, scores=[0.5] * i, stamp_ns=stamp)
        messages.append(raw("/odom", ODOMETRY, odometry(stamp_ns=stamp), stamp, stamp + 1))
        messages.append(raw("/boxes", BOXES, boxes, stamp, stamp + 2))
    return messages


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("compression", ["none", "message", "file"])
@pytest.mark.parametrize(("definitions", "metadata"), [(True, False), (False, True)])
def test_the_same_messages(
    tmp_path: Path, storage: Storage, compression: Compression, definitions: bool, metadata: bool
) -> None:
    folder = tmp_path / "rec"
    write_rosbag2(folder, recorded(), storage, compression, definitions=definitions)
    if not metadata:
        (folder / "metadata.yaml").unlink()
    with open_recording([folder]) as recording:
        got = list(recording.messages())
        assert {info.channel.definition != "" for info in recording.topics} == {definitions}
    assert [(m.topic, m.stamp_ns, bytes(m.data)) for m in got] == [(m.topic, m.stamp_ns, m.data) for m in recorded()]
    assert [repr(deserialize(m)) for m in got] == [repr(deserialize(m)) for m in recorded()]


def test_a_hash_tells_that_the_known_type_is_another_one(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "rec", recorded(), definitions=False)
    path = tmp_path / "rec" / "rec.db3"
    known = store_for("cdr").hash_rihs01(ODOMETRY)
    path.write_bytes(path.read_bytes().replace(known.encode(), b"RIHS01_" + b"0" * 64))
    with open_recording([path]) as recording:
        messages = {m.topic: m for m in recording.messages()}
    assert deserialize(messages["/boxes"]).header.frame_id == "camera"
    with pytest.raises(MessageError, match=r"/odom: .*no definition of nav_msgs/msg/Odometry.*RIHS01_000"):
        deserialize(messages["/odom"])


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_ros1_without_definitions(tmp_path: Path, compression: Literal["none", "lz4"]) -> None:
    message = raw("/odom", ODOMETRY, odometry(stamp_ns=T0), T0, encoding="ros1")
    bare = message._replace(channel=replace(message.channel, definition=""))
    write_rosbag1(tmp_path / "bare.bag", [bare], compression)
    other = tmp_path / "other.bag"
    write_rosbag1(other, [bare])
    other.write_bytes(other.read_bytes().replace(b"cd5e73d190d741a2f92e81eda573aca7", b"0" * 32))
    with open_recording([tmp_path / "bare.bag"]) as recording:
        assert [deserialize(m).child_frame_id for m in recording.messages()] == ["base_link"]
    with open_recording([other]) as recording:
        (found,) = recording.messages()
    with pytest.raises(MessageError, match=r"/odom: .*no definition of nav_msgs/msg/Odometry.*cd5e73"):
        deserialize(found)
