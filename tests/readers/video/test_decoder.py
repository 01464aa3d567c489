"""Packets to images: against the images that were encoded, and against OpenCV's decoder."""

from typing import Any

import numpy as np
import pytest
from video import (
    CODECS,
    PERIOD_NS,
    T0,
    Packet,
    compressed_video,
    encode,
    ffmpeg,
    ffmpeg_packet,
    foxglove,
    moving,
    pixels,
    psnr_db,
)

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.video.decoder import MAX_HELD, GapFinder, VideoDecoder
from lidcam.readers.video.packets import AFTER_DAMAGE, BEFORE_KEY_FRAME, read_packet

MANY = 40
STREAMS = {
    "plain": {},
    "baseline": {"profile": "baseline"},
    "main": {"profile": "main"},
    "slices": {"slices": "4"},
    "sliced threads": {"x264_params": "slice-max-size=200"},
    "B-frames": {"bf": "3", "b_adapt": "0", "tune": "psnr"},
    "B-frames that others refer to": {"bf": "3", "b_adapt": "0", "tune": "psnr", "x264_params": "b-pyramid=normal"},
    "refresh image by image": {"intra_refresh": "1"},
    "open groups": {"x264_params": "open-gop=1:bframes=2", "tune": "psnr"},
    "many references": {"refs": "8", "tune": "psnr", "bf": "0"},
}


def gaps(packets: list[Packet]) -> list[int]:
    """Places of the packets before which one is missing."""
    finder = GapFinder()
    read = [read_packet(compressed_video(packet.data, T0)) for packet in packets]
    found = [finder.gap_before(packet.data.data, is_key=packet.is_key) for packet in read]
    assert all("is missing, or" in gap for gap in found if gap)
    return [place for place, gap in enumerate(found) if gap]


@pytest.mark.parametrize("name", STREAMS)
def test_nothing_is_missing(name: str) -> None:
    assert gaps(encode(moving(MANY), gop=25, **STREAMS[name])) == []


@pytest.mark.parametrize("name", ["plain", "baseline", "main", "slices", "many references", "refresh image by image"])
@pytest.mark.parametrize("missing", [1, 16])
def test_one_is_missing(name: str, missing: int) -> None:
    packets = encode(moving(MANY), gop=25, **STREAMS[name])
    assert gaps([*packets[:missing], *packets[missing + 1 :]]) == [missing]


@pytest.mark.parametrize("missing", [1, 24])
def test_a_key_frame_ends_the_count(missing: int) -> None:
    packets = encode(moving(MANY), gop=25)
    assert gaps([*packets[:missing], *packets[25:]]) == []


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
