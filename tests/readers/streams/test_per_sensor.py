"""A recording as one topic per sensor: what passes, what changes, and that it is closed."""

from typing import Any

import pytest
from builders import image, odometry, raw
from combined_messages import CAMERAS, combined
from foxglove_messages import foxglove_raw
from memory_recording import MemoryRecording
from numpy import zeros

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import LimitsConfig
from lidcam.readers.streams.per_sensor import sensor_messages

T0 = 1_700_000_000 * 10**9
ODOMETRY = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0), T0)
IMAGE = raw("/x", "sensor_msgs/msg/Image", image(zeros((3, 4, 3), "u1"), stamp_ns=T0), T0)
WHOLE = combined("/c", CAMERAS, [IMAGE, IMAGE], T0 + 1, "cdr")
FOXGLOVE = foxglove_raw("/f", "foxglove.RawImage", {"timestamp": T0 + 7}, T0 + 2)


class Closable(MemoryRecording):
    """Knows whether it is open."""

    is_open = True
    fails = False

    def close(self) -> None:
        self.is_open = False

    def messages(self, topics: Any = None, **window: Any) -> Any:
        if self.fails:
            raise RecordingError("no disk")
        return super().messages(topics, **window)


def test_it_describes_the_same_recording() -> None:
    plain = Closable([ODOMETRY, WHOLE, FOXGLOVE])
    with sensor_messages(plain) as recording:
        assert [(t.topic, t.msgtype, t.message_count, t.part_of) for t in recording.topics] == [
            ("/c/camera_1", "sensor_msgs/msg/Image", 1, "/c"),
            ("/c/camera_2", "sensor_msgs/msg/Image", 1, "/c"),
            ("/f", "sensor_msgs/msg/Image", 1, ""),
            ("/odom", "nav_msgs/msg/Odometry", 1, ""),
        ]
        assert recording.paths == plain.paths
        assert (recording.start_ns, recording.end_ns, recording.message_count) == (T0, T0 + 2, 3)
        assert recording.losses == plain.losses
        got = list(recording.messages())
        assert got[0] == ODOMETRY._replace(order=(0, 0))
        assert [(m.topic, m.stamp_ns, m.order) for m in got[1:]] == [
            ("/c/camera_1", T0, (0, 1, 0)),
            ("/c/camera_2", T0, (0, 1, 1)),
            ("/f", T0 + 7, (0, 2)),
        ]
        assert {m.channel for m in got} == {channel for t in recording.topics for channel in t.channels}
    assert not plain.is_open


def test_it_is_closed_where_it_cannot_be_read() -> None:
    plain = Closable([WHOLE])
    plain.fails = True
    with pytest.raises(RecordingError, match="no disk"):
        sensor_messages(plain)
    assert not plain.is_open


def test_a_topic_of_both_kinds() -> None:
    """Combined messages and others on one topic: the others keep it."""
    other: RawMessage = ODOMETRY._replace(channel=raw("/c", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0), T0).channel)
    recording = sensor_messages(MemoryRecording([other, WHOLE]))
    assert [m.topic for m in recording.messages(["/c"])] == ["/c"]
    assert [m.topic for m in recording.messages(["/c/camera_2"])] == ["/c/camera_2"]
    assert [m.topic for m in recording.messages()] == ["/c", "/c/camera_1", "/c/camera_2"]


def test_limits_reach_what_is_split_or_converted() -> None:
    whole = combined("/c", CAMERAS, [IMAGE] * 5, T0 + 1, "cdr")
    transforms = [{"parent_frame_id": "a", "child_frame_id": f"b{i}"} for i in range(5)]
    foxglove = foxglove_raw("/tf", "foxglove.FrameTransforms", {"transforms": transforms}, T0 + 2)
    plain = MemoryRecording([whole, foxglove])
    assert [m.problem for m in sensor_messages(plain).messages()] == [""] * 6
    small = sensor_messages(plain, limits=LimitsConfig(max_message_items=2))
    assert [m.topic for m in small.messages()] == ["/c", "/tf"]  # no part of it was found
    assert "limit_scale" in next(iter(small.messages(["/tf"]))).problem
    later = sensor_messages(MemoryRecording([WHOLE] * 5 + [whole]), limits=LimitsConfig(max_message_items=4))
    problems = [message.problem for message in later.messages()]
    assert problems[:-2] == [""] * 10
    assert all("limit_scale" in problem for problem in problems[-2:])
