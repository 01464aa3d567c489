"""A recording as one topic per sensor: what passes, what changes, and that it is closed."""

from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal

import cv2
import numpy as np
import pytest
from builders import header, image, odometry, raw
from combined_messages import CAMERAS, combined
from foxglove_messages import foxglove_raw
from memory_recording import MemoryRecording
from numpy import zeros
from video import encode, moving, psnr_db, video_image

from lidcam.pipeline.core.errors import MessageError, RecordingError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.recording import Recording
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.readers.video.streams import VideoStreams, video_topics

T0 = 1_700_000_000 * 10**9
LOGGED = T0 + 10**9
Encoding = Literal["ros1", "cdr"]
both = pytest.mark.parametrize("encoding", ["ros1", "cdr"])


def images(encoding: Encoding, count: int, first_ns: int = T0) -> list[RawMessage]:
    rng = np.random.default_rng(first_ns % 1000 + count)
    sizes = rng.integers(3, 30, (count, 2))  # odd sizes shift what follows: CDR has to align it
    bodies = [
        image(rng.integers(0, 256, (h, w, 3), np.uint8), stamp_ns=first_ns + i, frame_id="f" * (i + 1))
        for i, (h, w) in enumerate(sizes.tolist())
    ]
    msgtype = "sensor_msgs/msg/Image"
    return [raw(f"/cam{i}", msgtype, body, first_ns + i, encoding=encoding) for i, body in enumerate(bodies)]


def opened(*messages: RawMessage) -> Recording:
    return sensor_messages(MemoryRecording(messages))


@both
@pytest.mark.parametrize("count", [1, 8])
def test_images(encoding: Encoding, count: int) -> None:
    parts = images(encoding, count)
    recording = opened(combined("/camera_msgs_combined", CAMERAS, parts, LOGGED, encoding))
    names = [f"/camera_msgs_combined/camera_{i + 1}" for i in range(count)]
    assert [(t.topic, t.msgtype, t.message_count) for t in recording.topics] == [
        (name, "sensor_msgs/msg/Image", 1) for name in names
    ]
    got = list(recording.messages())
    assert [m.topic for m in got] == names
    assert [m.stamp_ns for m in got] == [part.stamp_ns for part in parts]
    assert {m.log_time_ns for m in got} == {LOGGED}
    assert [m.order for m in got] == sorted({m.order for m in got})
    for message, part in zip(got, parts, strict=True):
        found, expected = decode_any_image(message), decode_any_image(part)
        assert (found.stamp_ns, found.frame_id) == (expected.stamp_ns, expected.frame_id)
        assert np.array_equal(found.rgb, expected.rgb)
        assert bytes(message.data) == part.data


@both
def test_the_definition_tells_not_the_name(encoding: Encoding) -> None:
    jpeg = cv2.imencode(".jpg", np.zeros((8, 9, 3), np.uint8))[1].reshape(-1)
    fields = {"header": header(T0, "a"), "format": "jpeg", "data": jpeg}
    part = raw("/a", "sensor_msgs/msg/CompressedImage", fields, T0, encoding=encoding)
    definition = "Header header\nsensor_msgs/CompressedImage[2] views"
    whole = combined("/rig", "a_msgs/msg/Rig", [part] * 2, LOGGED, encoding, definition=definition, field="views")
    assert [(m.topic, decode_any_image(m).rgb.shape) for m in opened(whole).messages()] == [
        ("/rig/views_1", (8, 9, 3)),
        ("/rig/views_2", (8, 9, 3)),
    ]


@both
@pytest.mark.parametrize(("form", "kind"), [("h264", "h264"), ("hevc", "h265")])
def test_packets_of_a_video_in_compressed_image(encoding: Encoding, form: str, kind: str) -> None:
    packets = encode(shown := moving(6), kind)
    messages = [video_image(packet.data, T0 + i, form, encoding) for i, packet in enumerate(packets)]
    recording = opened(*messages, messages[-1]._replace(data=messages[-1].data[:9]))
    assert [info.msgtype for info in recording.topics] == ["foxglove_msgs/msg/CompressedVideo"]
    *decoded, broken = VideoStreams(video_topics(recording, ["/camera/h264"])).decoded(recording.messages())
    assert "9 bytes" in broken.problem
    found = [decode_any_image(message) for message in decoded]
    assert [(image.stamp_ns, image.frame_id) for image in found] == [(T0 + i, "camera") for i in range(6)]
    assert min(psnr_db(image.rgb, rgb) for image, rgb in zip(found, shown, strict=True)) > 25


@both
def test_only_what_is_asked_for_is_read_and_taken_apart(encoding: Encoding) -> None:
    asked: list[object] = []

    class Watched(MemoryRecording):
        def messages(self, topics: Any = None, **window: Any) -> Iterator[RawMessage]:
            asked.append(topics)
            return super().messages(topics, **window)

    odom = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0), T0, T0, encoding)
    whole = combined("/c", CAMERAS, images(encoding, 4), LOGGED, encoding)
    recording = sensor_messages(Watched([odom, whole]))
    asked.clear()
    assert [m.topic for m in recording.messages(["/odom"])] == ["/odom"]
    assert [m.topic for m in recording.messages(["/c/camera_3", "/c/camera_2"])] == ["/c/camera_2", "/c/camera_3"]
    assert [m.topic for m in recording.messages(["/c"])] == []
    assert [m.topic for m in recording.messages(start_ns=LOGGED)] == [f"/c/camera_{i}" for i in (1, 2, 3, 4)]
    assert list(recording.messages(stop_ns=T0)) == []
    assert asked[:3] == [{"/odom"}, {"/c"}, {"/c"}]


@both
def test_lists_of_changing_length(encoding: Encoding) -> None:
    films = [images(encoding, count, T0 + i) for i, count in enumerate([0, 2, 1, 3])]
    recording = opened(*(combined("/c", CAMERAS, film, LOGGED + i, encoding) for i, film in enumerate(films)))
    counts = Counter(message.topic for message in recording.messages())
    assert counts == {"/c/camera_1": 3, "/c/camera_2": 2, "/c/camera_3": 1}
    assert [t.topic for t in recording.topics] == [*counts]


@both
def test_a_broken_message_is_a_problem_of_each_part(encoding: Encoding) -> None:
    good = combined("/c", CAMERAS, images(encoding, 2), LOGGED, encoding)
    broken = good._replace(data=good.data[:-20], log_time_ns=LOGGED - 1)
    recording = opened(broken, good)
    got = list(recording.messages())
    assert [(m.topic, m.log_time_ns, bool(m.problem)) for m in got] == [
        ("/c/camera_1", LOGGED - 1, True),
        ("/c/camera_2", LOGGED - 1, True),
        ("/c/camera_1", LOGGED, False),
        ("/c/camera_2", LOGGED, False),
    ]
    with pytest.raises(MessageError, match=r"/c/camera_2: /c: \d+ bytes are not a valid msgs/msg/MsgCamera"):
        deserialize(got[1])


def test_other_recordings_are_left_as_they_are() -> None:
    plain = MemoryRecording([raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0), T0)])
    assert sensor_messages(plain) is plain


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
