"""What MCAP files hold is told by encoding and schema of each channel, whatever the profile."""

from pathlib import Path
from typing import Any

import pytest
from builders import odometry, raw, write_mcap
from foxglove_messages import foxglove_raw
from mcap.records import Channel as RecordedChannel
from mcap.records import Schema

from lidcam.pipeline.core.messages import Channel
from lidcam.readers.files.mcap.mcap_file import channel_of
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.streams.per_sensor import sensor_messages

T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"
STATE1, STATE2 = (raw(f"/{e}", ODOMETRY, odometry(stamp_ns=T0 + 5), T0 + 5, T0, e) for e in ("ros1", "cdr"))
IMAGE = {"timestamp": T0 + 5, "frame_id": "camera", "format": "png", "data": b"abc"}
MIXED = [
    STATE1,
    STATE2,
    foxglove_raw("/protobuf", "foxglove.CompressedImage", IMAGE, T0, "protobuf"),
    foxglove_raw("/json", "foxglove.CompressedImage", IMAGE, T0, "json"),
]


@pytest.mark.parametrize("profile", ["", "ros1", "ros2", "else"])
@pytest.mark.parametrize("use_chunking", [True, False])
def test_mixed_encodings_in_one_file(tmp_path: Path, profile: str, use_chunking: bool) -> None:
    path = tmp_path / "mixed.mcap"
    write_mcap(path, MIXED, "zstd", profile=profile, use_chunking=use_chunking)
    with sensor_messages(open_recording([path])) as recording:
        assert {t.topic: t.msgtype for t in recording.topics} == {
            "/ros1": ODOMETRY,
            "/cdr": ODOMETRY,
            "/protobuf": "sensor_msgs/msg/CompressedImage",
            "/json": "sensor_msgs/msg/CompressedImage",
        }
        got = {message.topic: message for message in recording.messages()}
    assert {message.stamp_ns for message in got.values()} == {T0 + 5}
    assert got["/ros1"].channel == STATE1.channel
    for topic in ("/ros1", "/cdr"):
        assert deserialize(got[topic]).child_frame_id == "base_link"
    for topic in ("/protobuf", "/json"):
        assert deserialize(got[topic]).data.tobytes() == b"abc"


def recorded(encoding: str, schema: str, name: str, data: bytes = b"", **metadata: str) -> Channel | str:
    channel = RecordedChannel(id=1, topic="/t", message_encoding=encoding, metadata=metadata, schema_id=1)
    return channel_of(channel, Schema(id=1, name=name, encoding=schema, data=data), "jazzy")


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (recorded("ros1", "ros1msg", "nav_msgs/Odometry"), Channel("/t", ODOMETRY, "ros1", "", "ros1msg", "jazzy")),
        (recorded("ros1", "", "nav_msgs/Odometry"), Channel("/t", ODOMETRY, "ros1", "", "ros1msg", "jazzy")),
        (recorded("cdr", "ros2idl", ODOMETRY, b"x"), Channel("/t", ODOMETRY, "cdr", "x", "ros2idl", "jazzy")),
        (recorded("cdr", "", ODOMETRY), Channel("/t", ODOMETRY, "cdr", "", "ros2msg", "jazzy")),
        (
            recorded("cdr", "ros2msg", ODOMETRY, topic_type_hash="RIHS01_00"),
            Channel("/t", ODOMETRY, "cdr", "", "ros2msg", "jazzy", "RIHS01_00"),
        ),
        (
            recorded("protobuf", "protobuf", "foxglove.RawImage", b"\0\xff"),
            Channel("/t", "foxglove.RawImage", "protobuf", "AP8=", "protobuf", "jazzy"),
        ),
    ],
)
def test_channels(found: Any, expected: Channel) -> None:
    assert found == expected


@pytest.mark.parametrize(
    ("encoding", "schema", "name", "says"),
    [
        ("protobuf", "protobuf", "foxglove.SceneUpdate", "protobuf encoding, protobuf schema foxglove.SceneUpdate"),
        ("json", "jsonschema", "Speed", "json encoding, jsonschema schema Speed"),
        ("flatbuffer", "flatbuffer", "foxglove.RawImage", "flatbuffer encoding"),
        ("cdr", "ros1msg", ODOMETRY, "cdr encoding, ros1msg schema"),
        ("", "", "", "no encoding"),
    ],
)
def test_channels_that_cannot_be_read(encoding: str, schema: str, name: str, says: str) -> None:
    found = recorded(encoding, schema, name)
    assert isinstance(found, str)
    assert says in found
    assert "lidcam reads cdr" in found
