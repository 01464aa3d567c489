"""Video topics in the stream of messages: every message once, the right images, whatever synchronisation takes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from builders import camera_info, image, odometry, raw, tf_message, transform_stamped
from builders import pointcloud2 as cloud
from foxglove_messages import twin
from memory_recording import MemoryRecording
from video import PERIOD_NS, T0, compressed_video, encode, ffmpeg, foxglove, moving, pixels, psnr_db, video_image

from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.messages import Drop, RawMessage, VideoPart
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import TopicsConfig
from lidcam.pipeline.core.settings.sync import SyncConfig
from lidcam.pipeline.stages.sync.synchronize import synchronize
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.readers.streams.survey import survey
from lidcam.readers.video.packets import BEFORE_KEY_FRAME
from lidcam.readers.video.streams import LOOK_BACK_NS, VideoStreams, first_image_size, video_topics

COUNT, GOP = 12, 4
IMAGES = moving(COUNT)
PACKETS = encode(IMAGES, gop=GOP)
FILM = foxglove(PACKETS)
TOPIC = FILM[0].topic
K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])


def streamed(messages: Sequence[RawMessage], topics: Sequence[str] = (TOPIC,)) -> list[RawMessage]:
    return list(VideoStreams(topics).decoded(messages))


def window(first: int, messages: Sequence[RawMessage] = FILM) -> list[RawMessage]:
    """What a window that begins with message `first` holds, after looking back."""
    recording, start_ns = MemoryRecording(messages), messages[first].log_time_ns
    streams = VideoStreams([TOPIC])
    streams.look_back(recording, start_ns)
    return list(streams.decoded(recording.messages([TOPIC], start_ns=start_ns)))


def test_other_messages_pass() -> None:
    other = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0), T0)
    image_message = raw(TOPIC, "sensor_msgs/msg/Image", image(IMAGES[0], stamp_ns=T0), T0)
    unused = compressed_video(b"\1", T0, topic="/unused")
    found = streamed([other, FILM[0], image_message, unused, FILM[1]])
    assert (found[0], found[2], found[3]) == (other, image_message, unused)
    assert [m.channel.msgtype for m in (found[1], found[4])] == ["sensor_msgs/msg/CompressedImage"] * 2


@pytest.mark.parametrize("first", [1, GOP - 1, GOP, GOP + 1, COUNT - 1])
def test_a_window_shows_what_the_whole_shows(first: int) -> None:
    assert window(first) == [m._replace(order=(0, n)) for n, m in enumerate(streamed(FILM))][first:]


def test_a_window_with_no_key_frame_near_waits_for_the_next() -> None:
    late = LOOK_BACK_NS + PERIOD_NS
    messages = [FILM[0], *(m._replace(log_time_ns=m.log_time_ns + late) for m in FILM[1:])]
    found = window(2, messages)
    assert [m.problem for m in found] == [BEFORE_KEY_FRAME] * (GOP - 2) + [""] * (COUNT - GOP)
    whole = streamed(messages)
    assert [m.data for m in found if not m.problem] == [m.data for m in whole[GOP:]]


def bundles_of(messages: Sequence[RawMessage]) -> tuple[list[SensorBundle], list[Drop], list[Drop]]:
    """Frames of the video and of a lidar at half its rate; drops of sync and before the key frame; bad messages."""
    clock = [
        raw("/lidar", "nav_msgs/msg/Odometry", odometry(stamp_ns=T0 + n * PERIOD_NS), T0 + n * PERIOD_NS)
        for n in range(0, COUNT, 2)
    ]
    streams = VideoStreams([TOPIC])
    stream = streams.decoded(sorted([*clock, *messages], key=lambda m: m.log_time_ns))
    drops: list[Drop] = []
    bad: list[Drop] = []
    bundles = synchronize(
        stream, ["/lidar", TOPIC], SyncConfig(max_interval_s=0.01), reference="/lidar", on_drop=drops.append
    )
    return list(streams.without_blanks(bundles, on_drop=drops.append, on_bad=bad.append)), drops, bad


def test_frames_that_synchronisation_leaves_out_are_decoded_all_the_same() -> None:
    bundles, drops, bad = bundles_of(FILM)
    assert [bundle.stamp_ns for bundle in bundles] == [T0 + n * PERIOD_NS for n in range(0, COUNT, 2)]
    for number, bundle in enumerate(bundles):
        assert psnr_db(pixels(bundle.messages[TOPIC]), IMAGES[2 * number]) > 33
    assert (len(drops), bad) == (COUNT // 2, [])


def test_messages_without_an_image_leave_their_frame_and_are_counted() -> None:
    broken = [*FILM[1:6], FILM[6]._replace(data=FILM[6].data[:40]), *FILM[7:]]
    bundles, drops, bad = bundles_of(broken)
    assert [bundle.stamp_ns for bundle in bundles] == [T0 + n * PERIOD_NS for n in range(2, COUNT, 2)]
    assert [TOPIC in bundle.messages for bundle in bundles] == [False, True, False, True, True]
    assert all("/lidar" in bundle.messages for bundle in bundles)
    assert [(d.stamp_ns, d.detail) for d in drops if d.reason == BEFORE_KEY_FRAME] == [(T0 + 2 * PERIOD_NS, "")]
    assert [(d.topic, d.stamp_ns, d.reason) for d in bad] == [(TOPIC, T0 + 6 * PERIOD_NS, "cannot be decoded")]
    assert bundles[0].dropped_before[TOPIC, BEFORE_KEY_FRAME] == 1
    assert bundles[2].dropped_before[TOPIC, "cannot be decoded"] == 1


@pytest.mark.parametrize("kind", ["h264", "h265", "vp9"])
def test_the_size_of_the_first_image(kind: str) -> None:
    messages = foxglove(encode(moving(6, 80, 64), kind, gop=4), kind)
    assert first_image_size(messages) == (80, 64)
    assert first_image_size(messages[1:]) == (80, 64)
    assert first_image_size(messages[1:3]) is None
    assert first_image_size([]) is None


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_foxglove_schemas_say_the_same(encoding: Any) -> None:
    twins = [twin(message, encoding) for message in FILM]
    assert {m.channel.msgtype for m in twins} == {"foxglove.CompressedVideo"}
    recording = sensor_messages(MemoryRecording(twins))
    assert [(t.topic, t.msgtype) for t in recording.topics] == [(TOPIC, "foxglove_msgs/msg/CompressedVideo")]
    found = [(m.stamp_ns, m.log_time_ns, m.data) for m in streamed(list(recording.messages()))]
    assert found == [(m.stamp_ns, m.log_time_ns, m.data) for m in streamed(FILM)]


def rig_of(film: Sequence[RawMessage], *, size: tuple[int, int] = (64, 48), **topics: Any) -> Discovery:
    """The rig of a recording of a lidar and one camera with calibration."""
    info = camera_info(K, stamp_ns=T0, width_px=size[0], height_px=size[1])
    pose = transform_stamped("lidar", "camera", stamp_ns=T0, rotation_xyzw=(-0.5, 0.5, -0.5, 0.5))
    messages = [
        raw("/points", "sensor_msgs/msg/PointCloud2", cloud(np.ones((3, 3), "f4"), stamp_ns=T0), T0),
        raw("/camera/camera_info", "sensor_msgs/msg/CameraInfo", info, T0),
        raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message([pose]), T0),
        *film,
    ]
    config = Config(topics=TopicsConfig.model_validate(topics))
    return discover_rig(sensor_messages(MemoryRecording(messages)), config)


@pytest.mark.parametrize("name", ["image_raw/ffmpeg", "h264", "compressed_video"])
def test_a_camera_is_found(name: str) -> None:
    topic = f"/camera/{name}"
    for film in (foxglove(PACKETS, topic=topic), ffmpeg(PACKETS, topic=topic), foxglove(PACKETS, topic=topic)[2:]):
        found = rig_of(film)
        assert [(c.name, c.topic, c.model.frame_id) for c in found.rig.cameras] == [("camera", topic, "camera")]
        assert not found.faults


def test_without_the_decoder_the_topic_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.readers.video.packets.find_spec", lambda _: None)
    remedy = "it is video, which needs PyAV: pip install 'lidcam[video]'"
    images = [video_image(packet.data, T0) for packet in PACKETS]
    for film in (FILM, [twin(message, "protobuf") for message in FILM], images):
        found = rig_of(film)
        assert [(fault.topic, fault.reason) for fault in found.faults] == [(film[0].topic, remedy)]
        assert not found.rig.cameras
        recording = sensor_messages(MemoryRecording(film))
        [info] = recording.topics
        assert (info.msgtype, info.message_count) == ("foxglove_msgs/msg/CompressedVideo", COUNT)
        assert info.unreadable == remedy
        assert list(recording.messages()) == []
        assert [topic.problem for topic in survey(recording)] == [remedy]
        assert video_topics(recording, [TOPIC]) == ()


def bundled(messages: Sequence[RawMessage], every: int = 1) -> list[SensorBundle]:
    """Frames of every Nth image, with the packets that each has."""
    streams = VideoStreams([TOPIC])
    images = list(streams.decoded(messages))[::every]
    found = (SensorBundle(n, m.stamp_ns, m.log_time_ns, {TOPIC: m}) for n, m in enumerate(images))
    return list(streams.without_blanks(found, on_drop=lambda _: None, on_bad=lambda _: None))


@pytest.mark.parametrize(("every", "expected"), [(1, [[0], [1], [2], [3], [4], [5]]), (3, [[0], [1, 2, 3]])])
def test_a_frame_has_the_packets_since_the_one_before(every: int, expected: list[list[int]]) -> None:
    numbered = [m._replace(order=(0, n)) for n, m in enumerate(FILM[:6])]
    found = [bundle.video[TOPIC] for bundle in bundled(numbered, every)]
    assert found == [VideoPart("h264", tuple(PACKETS[n].data for n in numbers)) for numbers in expected]


def test_it_has_none_from_before_a_key_frame() -> None:
    *_, last = bundled([m._replace(order=(0, n)) for n, m in enumerate(FILM)], COUNT - 1)
    assert last.video[TOPIC].packets == tuple(packet.data for packet in PACKETS[2 * GOP :])


@pytest.mark.parametrize("kind", ["h265", "vp9", "av1", "vp8"])
def test_other_codecs_have_packets_too(kind: str) -> None:
    packets = encode(IMAGES, kind, gop=GOP)
    found = bundled([m._replace(order=(0, n)) for n, m in enumerate(foxglove(packets, kind))])
    assert [bundle.video[TOPIC].packets for bundle in found] == [(packet.data,) for packet in packets]


def test_packets_that_wait_in_vain_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.readers.video.decoder.MAX_KEPT_BYTES", len(PACKETS[0].data))
    first, last = bundled([m._replace(order=(0, n)) for n, m in enumerate(FILM)], COUNT - 2)
    assert not first.video
    assert last.video[TOPIC].packets == tuple(packet.data for packet in PACKETS[2 * GOP : COUNT - 1])


def test_packets_that_do_not_decode_alone_stay_out() -> None:
    """After a loss there are none before the next key frame, and none at all where images come out of order."""
    lost = [m._replace(order=(0, n)) for n, m in enumerate(FILM) if n != 1]
    assert [TOPIC in bundle.video for bundle in bundled(lost)] == [True] + [False] * (GOP - 2) + [True] * (COUNT - GOP)
    for options in ({"bf": "2", "b_adapt": "0", "tune": "psnr"}, {"intra_refresh": "1"}):
        found = bundled([m._replace(order=(0, n)) for n, m in enumerate(foxglove(encode(IMAGES, gop=GOP, **options)))])
        assert sum(TOPIC in bundle.video for bundle in found) == (0 if "bf" in options else COUNT)
