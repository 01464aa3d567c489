"""Which codec a message's packet is of, and whether decoding can begin with it."""

from dataclasses import replace
from typing import Any

import pytest
from builders import header, serialize, store_for
from rosbags.typesys import get_types_from_msg
from video import T0, compressed_video, ffmpeg_packet

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.header_stamp import stamp_or_log_time
from lidcam.readers.video.packets import FFMPEG_PACKET, read_packet


@pytest.mark.parametrize(
    ("data", "codec", "is_key"),
    [
        (b"\0\0\0\1\x67\x42", "h264", True),  # parameter sets alone: some encoders send them as a packet of their own
        (b"\0\0\1\x09\x10\0\0\1\x65\x88", "h264", True),  # behind an access unit delimiter
        (b"\0\0\1\x06\x06\x01\xc4\x80\0\0\1\x41\x9a", "h264", True),  # recovery point
        (b"\0\0\1\x06\x05\x01\xc4\x80\0\0\1\x41\x9a", "h264", False),  # other information
        (b"\0\0\1\x41\x9a", "h264", False),
        (b"\x65\0\0\1", "h264", False),
        (b"\0\0\1\x26\x01", "hevc", True),
        (b"\0\0\1\x2a\x01", "hevc", True),  # clean random access
        (b"\0\0\1\x40\x01", "hevc", True),
        (b"\0\0\1\x02\x01", "hevc", False),
        (b"\x82", "vp9", True),
        (b"\x86", "vp9", False),
        (b"\x88", "vp9", False),  # shows an image that was decoded before
        (b"\xb0", "vp9", True),  # profile 3
        (b"\xb2", "vp9", False),
        (b"\x42", "vp9", False),
        (b"\x12\0\x0a\x0a", "av1", True),
        (b"\x0a\x0a", "av1", True),
        (b"\x12\0\x32", "av1", False),
        (b"\x12\0", "av1", False),
        (b"\x10", "vp8", True),
        (b"\x11", "vp8", False),
        (b"\0", "mjpeg", True),
        (b"\0", "mpeg4", False),
    ],
)
def test_key_frames_by_hand(data: bytes, codec: str, is_key: bool) -> None:
    assert read_packet(ffmpeg_packet(data, T0, name=codec)).is_key == is_key


def test_codecs_without_a_sign_of_their_own_go_by_the_flag() -> None:
    assert read_packet(ffmpeg_packet(b"\0", T0, name="mpeg4", flags=1)).is_key
    assert not read_packet(ffmpeg_packet(b"\0\0\1\x41", T0, name="h264", flags=1)).is_key


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("h264", "h264"),
        ("H.264", "h264"),
        ("h264_nvenc", "h264"),
        ("h264;yuv420p;bgr8;bgr8", "h264"),
        ("hevc_vaapi;nv12;rgb8;rgb8", "hevc"),
        ("libvpx-vp9", "vp9"),
        ("libvpx", "vp8"),
        ("libsvtav1", "av1"),
    ],
)
def test_names_of_codecs_and_encoders(name: str, codec: str) -> None:
    assert read_packet(ffmpeg_packet(b"\1", T0, name=name)).codec == codec


@pytest.mark.parametrize("name", ["", "h266", ";h264", "xh264", "h264 or so"])
def test_unknown_names(name: str) -> None:
    with pytest.raises(MessageError, match="expected one of h264, hevc, vp9, av1, vp8, mpeg4, mjpeg"):
        read_packet(ffmpeg_packet(b"\1", T0, name=name))


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize("with_definition", [True, False])
def test_stamps_are_peeked(encoding: Any, with_definition: bool) -> None:
    """Without the definition, too: sqlite3 recordings before ROS 2 Iron have none."""
    for message in (
        compressed_video(b"\1", T0 + 7, encoding=encoding),
        ffmpeg_packet(b"\1", T0 + 7, encoding=encoding),
    ):
        known = message.channel if with_definition else replace(message.channel, definition="")
        assert stamp_or_log_time(known, message.data, 7) == T0 + 7
        assert read_packet(message._replace(channel=known)).codec == "h264"


def test_the_first_ffmpeg_packets_had_other_names() -> None:
    """ROS 1's package called the size img_width and img_height: the recorded definition decides."""
    size = "int32 img_width\nint32 img_height"
    text = f"std_msgs/Header header\n{size}\nstring encoding\nuint64 pts\nuint8 flags\nuint8[] data"
    store = store_for("ros1").__class__()
    store.register({**store_for("ros1").fielddefs, **get_types_from_msg(text, FFMPEG_PACKET)})
    fields = {"header": header(T0, "cam"), "encoding": "libx264", "data": b"\0\0\1\x65"}
    data = serialize(FFMPEG_PACKET, fields, "ros1", store)
    definition, _ = store.generate_msgdef(FFMPEG_PACKET)
    message = RawMessage(T0, T0, (0, 0), data, Channel("/v", FFMPEG_PACKET, "ros1", definition, "ros1msg"))
    assert (read_packet(message).codec, read_packet(message).is_key) == ("h264", True)
