"""What MCAP files hold is told by encoding and schema of each channel, whatever the profile."""

from pathlib import Path
from typing import Any

import pytest
from builders import image, odometry, raw, write_mcap
from foxglove_messages import foxglove_raw
from mcap.records import Channel as RecordedChannel
from mcap.records import Schema
from mcap.writer import Writer
from numpy import zeros

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.files.mcap.mcap_file import channel_of
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.open import open_recording
from lidcam.readers.streams.per_sensor import sensor_messages

T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"


def states(log_times_ns: list[int], topic: str = "/odom") -> list[RawMessage]:
    return [raw(topic, ODOMETRY, odometry(stamp_ns=T0 + i), T0 + i, log) for i, log in enumerate(log_times_ns)]


def test_topics_that_cannot_be_read_are_listed_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "mixed.mcap"
    with path.open("xb") as stream:
        writer = Writer(stream)
        writer.start("", "tests")
        json_schema = writer.register_schema("Speed", "jsonschema", b"{}")
        proto = writer.register_schema("foxglove.SceneUpdate", "protobuf", b"\0")
        flat = writer.register_schema("foxglove.RawImage", "flatbuffer", b"\0")
        ros1 = writer.register_schema(ODOMETRY, "ros1msg", b"")
        channels = (
            *(("/speed", "json", json_schema), ("/scene", "protobuf", proto), ("/x", "cdr", 0), ("/y", "", 0)),
            *(("/flat", "flatbuffer", flat), ("/old", "cdr", ros1)),
        )
        for topic, encoding, schema in channels:
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 10, b"{}", 10)
        state = states([7])[0]
        odom = writer.register_schema(ODOMETRY, "ros2msg", state.channel.definition.encode())
        writer.add_message(writer.register_channel("/odom", "cdr", odom), 7, bytes(state.data), 7)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    with open_recording([path]) as recording:
        assert recording.message_count == 7
        assert [(m.topic, m.log_time_ns) for m in recording.messages()] == [("/odom", 7)]
        listed = {t.topic: t for t in recording.topics}
    assert {t.message_count for t in listed.values()} == {1}
    assert listed["/odom"].unreadable == ""
    told = {
        "/speed": "json encoding, jsonschema schema Speed",
        "/scene": "protobuf encoding, protobuf schema foxglove.SceneUpdate",
        "/x": "no schema",
        "/y": "no encoding",
        "/flat": "flatbuffer encoding",
        "/old": "cdr encoding, ros1msg schema",
    }
    for topic, text in told.items():
        assert text in listed[topic].unreadable
        assert "lidcam reads cdr" in listed[topic].unreadable
    with pytest.raises(RecordingError, match="/speed: Speed cannot be read"):
        _ = listed["/speed"].channel


def test_large_messages_are_views_and_small_ones_are_copies(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    image_message = image(zeros((100, 100, 3), "u1"), stamp_ns=T0)
    messages = [raw("/image", "sensor_msgs/msg/Image", image_message, T0, T0), *states([T0 + 1])]
    write_mcap(path, messages, "lz4")
    with open_recording([path]) as recording:
        got = list(recording.messages())
    assert [type(m.data) for m in got] == [memoryview, bytes]
    assert [bytes(m.data) for m in got] == [m.data for m in messages]


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
