from pathlib import Path

import pytest
from builders import image, odometry, raw, write_mcap
from mcap.writer import Writer
from numpy import zeros

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.open import open_recording

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
        channels = ("/speed", "json", json_schema), ("/scene", "protobuf", proto), ("/x", "cdr", 0)
        for topic, encoding, schema in channels:
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 10, b"{}", 10)
        state = states([7])[0]
        odom = writer.register_schema(ODOMETRY, "ros2msg", state.channel.definition.encode())
        writer.add_message(writer.register_channel("/odom", "cdr", odom), 7, bytes(state.data), 7)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap annotates in part
    with open_recording([path]) as recording:
        assert recording.message_count == 4
        assert [(m.topic, m.log_time_ns) for m in recording.messages()] == [("/odom", 7)]
        listed = {t.topic: t for t in recording.topics}
    assert [t.message_count for t in listed.values()] == [1, 1, 1, 1]
    assert listed["/odom"].unreadable == ""
    assert "json encoding, jsonschema schema" in listed["/speed"].unreadable
    assert "protobuf" in listed["/scene"].unreadable
    assert "no schema" in listed["/x"].unreadable
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
