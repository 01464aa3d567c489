from pathlib import Path
from typing import Any, Literal

import pytest
from builders import image, odometry, raw, write_mcap
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy import zeros

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.open import open_recording

T0 = 1_700_000_000 * 10**9
ODOMETRY = "nav_msgs/msg/Odometry"


def states(log_times_ns: list[int], topic: str = "/odom") -> list[RawMessage]:
    return [raw(topic, ODOMETRY, odometry(stamp_ns=T0 + i), T0 + i, log) for i, log in enumerate(log_times_ns)]


@given(
    log_times=st.lists(st.integers(0, 20), max_size=40),
    chunk_bytes=st.sampled_from([1, 1500, 4000, 10**6]),
    compression=st.sampled_from(["none", "lz4", "zstd"]),
    start=st.none() | st.integers(0, 10),
    stop=st.none() | st.integers(10, 21),
)
def test_same_order_as_the_mcap_library(
    tmp_path_factory: pytest.TempPathFactory,
    log_times: list[int],
    chunk_bytes: int,
    compression: Literal["none", "lz4", "zstd"],
    start: int | None,
    stop: int | None,
) -> None:
    path = tmp_path_factory.mktemp("mcap") / "any.mcap"
    write_mcap(path, states(log_times), compression, chunk_bytes=chunk_bytes)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        expected = [
            (message.log_time, message.data)
            for _, _, message in reader.iter_messages(starting_at=start, ending_before=stop)
        ]
    with open_recording([path]) as recording:
        got = [(m.log_time_ns, bytes(m.data)) for m in recording.messages(start_ns=start, stop_ns=stop)]
    assert got == expected


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_statistics": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
    ],
)
def test_files_whose_summary_lacks_something(tmp_path: Path, options: dict[str, Any]) -> None:
    messages = states([5, 3, 8, 8, 1]) + states([2, 9], "/other")
    path = tmp_path / "short.mcap"
    write_mcap(path, messages, "zstd", chunk_bytes=1500, **options)
    with open_recording([path]) as recording:
        assert [(t.topic, t.message_count) for t in recording.topics] == [("/odom", 5), ("/other", 2)]
        assert (recording.start_ns, recording.end_ns) == (1, 9)
        assert [m.log_time_ns for m in recording.messages()] == [1, 2, 3, 5, 8, 8, 9]
        assert [m.log_time_ns for m in recording.messages(["/other"])] == [2, 9]


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
