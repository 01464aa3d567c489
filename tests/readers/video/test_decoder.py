"""Packets to images: against the images that were encoded, and against OpenCV's decoder."""

from typing import Any

import numpy as np
import pytest
from video import CODECS, PERIOD_NS, T0, encode, ffmpeg, ffmpeg_packet, foxglove, moving, pixels, psnr_db

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.video.decoder import MAX_HELD, VideoDecoder
from lidcam.readers.video.packets import AFTER_DAMAGE, BEFORE_KEY_FRAME

COUNT, GOP = 9, 4
NONSENSE = b"\0\0\0\1\x41" + b"nonsense" * 20
"""A slice of H.264 by its first byte, and after that of a number that does not follow."""


def decoded(messages: list[RawMessage]) -> list[RawMessage]:
    decoder = VideoDecoder(messages[0].topic if messages else "/camera/video")
    return [*(found for message in messages for found in decoder.add_message(message)), *decoder.flush()]


def assert_shows(found: list[RawMessage], images: list[Any], *, least_db: float = 33) -> None:
    """Each message has the image of its stamp, and no other image would fit as well."""
    for message in found:
        own = (message.stamp_ns - T0) // PERIOD_NS
        fits = [psnr_db(pixels(message), image) for image in images]
        assert fits[own] > least_db, message.stamp_ns
        assert np.argmax(fits) == own


@pytest.mark.parametrize("kind", CODECS)
def test_images_are_those_that_were_encoded(kind: str) -> None:
    images = moving(COUNT)
    messages = (ffmpeg if kind in {"vp8", "mpeg4", "mjpeg"} else foxglove)(encode(images, kind, gop=GOP), kind)
    found = decoded(messages)
    assert [(m.stamp_ns, m.log_time_ns, m.order, m.problem) for m in found] == [
        (m.stamp_ns, m.log_time_ns, m.order, "") for m in messages
    ]
    assert {(m.topic, m.channel.msgtype) for m in found} == {(messages[0].topic, "sensor_msgs/msg/CompressedImage")}
    assert_shows(found, images)


@pytest.mark.parametrize("kind", ["h264", "h265"])
def test_images_out_of_order(kind: str) -> None:
    """B-frames: packets come in the order of decoding, each image goes to the message of its packet."""
    images = moving(COUNT)
    own = {"h264": {"bf": "2", "b_adapt": "0", "tune": "psnr"}, "h265": {"x265_params": "bframes=2:log-level=none"}}
    packets = encode(images, kind, gop=GOP, **own[kind])
    assert [packet.image for packet in packets] != sorted(packet.image for packet in packets)
    messages = ffmpeg(packets, kind)
    found = decoded(messages)
    assert [m.stamp_ns for m in found] == sorted(m.stamp_ns for m in messages)
    assert {(m.stamp_ns, m.log_time_ns) for m in found} == {(m.stamp_ns, m.log_time_ns) for m in messages}
    assert_shows(found, images)


@pytest.mark.parametrize("kind", ["h264", "h265", "vp9", "av1"])
def test_it_begins_with_a_key_frame(kind: str) -> None:
    images, first = moving(COUNT), 1
    packets = encode(images, kind, gop=GOP)
    found = decoded(foxglove(packets[first:], kind))
    key = next(place for place, packet in enumerate(packets) if packet.is_key and place >= first)
    assert [m.problem for m in found] == [BEFORE_KEY_FRAME] * (key - first) + [""] * (COUNT - key)
    assert all(not m.data for m in found if m.problem)
    assert_shows(found[key - first :], images)


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        *((kind, fault) for kind in ("h264", "h265", "vp9", "av1") for fault in ("empty", "ones")),
        *((kind, "nonsense") for kind in ("h264", "h265", "vp9")),  # the others cannot tell
        *((kind, "half") for kind in ("h264", "av1")),
    ],
)
def test_after_damage_it_begins_again(kind: str, fault: str) -> None:
    images = moving(COUNT)
    packets = encode(images, kind, gop=GOP)
    half = packets[1].data[: len(packets[1].data) // 2]
    data = {"empty": b"", "ones": b"\xff" * 40, "nonsense": NONSENSE, "half": half}[fault]
    damaged = [packets[0], packets[1]._replace(data=data), *packets[2:]]
    found = decoded(foxglove(damaged, kind))
    assert [m.problem == "" for m in found] == [place == 0 or place >= GOP for place in range(COUNT)]
    reason = "without data" if not data else f"{len(data)} bytes are not valid {CODECS[kind][0]}"
    assert ("this one is broken" if (kind, fault) == ("h264", "nonsense") else reason) in found[1].problem
    assert [m.problem for m in found[2:GOP]] == [AFTER_DAMAGE] * (GOP - 2)
    assert_shows([m for m in found if not m.problem], images)


@pytest.mark.parametrize("kind", ["h264", "vp9"])
def test_the_size_changes(kind: str) -> None:
    small, large = moving(3, 64, 48), moving(6, 128, 96)
    packets = [*encode(small, kind), *encode(large[3:], kind)]
    messages = foxglove([p._replace(image=place) for place, p in enumerate(packets)], kind)
    found = decoded(messages)
    assert [m.problem for m in found] == [""] * 6
    assert [pixels(m).shape[:2] for m in found] == [(48, 64)] * 3 + [(96, 128)] * 3
    for message, image in zip(found, [*small, *large[3:]], strict=True):
        assert psnr_db(pixels(message), image) > 33


def test_packets_that_give_no_image_do_not_pile_up() -> None:
    """Parameter sets over and over, in a stream of images out of order: nothing is held for ever."""
    packets = encode(moving(COUNT), gop=GOP, bf="2", b_adapt="0", tune="psnr")
    data = packets[0].data
    sets = data[: data.index(b"\0\0\1\x65") - 1]
    messages = [*ffmpeg(packets[:3]), *(ffmpeg_packet(sets, T0 + n) for n in range(200))]
    decoder = VideoDecoder(messages[0].topic)
    came = 0
    for count, message in enumerate(messages, 1):
        came += len(decoder.add_message(message))
        assert count - came <= MAX_HELD + 1
    assert came + len(decoder.flush()) == len(messages)


def test_the_settings_bound_the_size() -> None:
    messages = foxglove(encode(moving(2, 160, 120)))
    for mpx, is_shown in ((0.1, True), (0.01, False)):
        decoder = VideoDecoder(messages[0].topic, limits=RecordingLimits(max_image_mpx=mpx))
        assert [not found.problem for message in messages for found in decoder.add_message(message)] == [is_shown] * 2
