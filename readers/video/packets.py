"""Video messages, one packet each: the codec, and whether decoding can begin with the packet.

Sources: docs.foxglove.dev/docs/sdk/schemas/compressed-video (H.264 and H.265 in Annex B form, AV1 in low-overhead form,
one image per message); ffmpeg_image_transport_msgs/FFMPEGPacket, whose `encoding` is a codec or FFmpeg encoder, in
newer releases followed by pixel formats (`hevc;yuv420p;bgr8;bgr8`); ITU-T H.264 and H.265, table 7-1 each; the
bitstream specifications of VP9 (6.2), VP8 (RFC 6386, 9.1) and AV1 (5.3).
"""

import re
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.image import COMPRESSED_IMAGE
from lidcam.readers.messages.tf import clean_frame

COMPRESSED_VIDEO = "foxglove_msgs/msg/CompressedVideo"
FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
VIDEO = frozenset({COMPRESSED_VIDEO, FFMPEG_PACKET})

BEFORE_KEY_FRAME = "before the first key frame of the video"
AFTER_DAMAGE = "after a packet that cannot be decoded, before the next key frame of the video"

KEY_FLAG = 1  # AV_PKT_FLAG_KEY

# Names of codecs and of FFmpeg's encoders (libx264, h264_nvenc, hevc_vaapi, libvpx-vp9, libsvtav1) by decoder.
_NAMES = {
    "h264": re.compile(r"(h\.?264|avc1?|(lib)?x264(rgb)?|libopenh264)(_\w+)?"),
    "hevc": re.compile(r"(h\.?265|hevc|(lib)?x265)(_\w+)?"),
    "vp9": re.compile(r"(vp9|libvpx-vp9)(_\w+)?"),
    "av1": re.compile(r"(av1|libaom-av1|libsvtav1|librav1e)(_\w+)?"),
    "vp8": re.compile(r"(vp8|libvpx)(_\w+)?"),
    "mpeg4": re.compile(r"mpeg4(_\w+)?"),
    "mjpeg": re.compile(r"mjpeg(_\w+)?"),
}

# H.264: slice of an IDR image (5), sequence parameter set (7), or recovery point (message 6 first in an SEI, 6), as an
# encoder with gradual refresh never sends another IDR. H.265: random access images (16 to 23), parameter sets (32 to
# 34). Start codes occur nowhere else: the standards escape them.
_KEY_UNITS = {
    "h264": re.compile(rb"\x00\x00\x01(?:[\x05\x25\x45\x65\x07\x27\x47\x67]|\x06\x06)"),
    "hevc": re.compile(rb"\x00\x00\x01[\x20\x22\x24\x26\x28\x2a\x2c\x2e\x40\x42\x44]"),
}
# Parameter sets of the sequence, and images that refer to no other.
_FIRST_UNITS = {
    "h264": (re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]"), re.compile(rb"\x00\x00\x01[\x05\x25\x45\x65]")),
    "hevc": (re.compile(rb"\x00\x00\x01\x42"), re.compile(rb"\x00\x00\x01[\x20\x22\x24\x26\x28\x2a]")),
}
_TEMPORAL_DELIMITER, _SEQUENCE_HEADER = b"\x12\x00", 1


class VideoPacket(NamedTuple):
    """One packet of a video."""

    codec: str  # `h264`, `hevc`, `vp9`, `av1`, `vp8`, `mpeg4` or `mjpeg`
    data: U8  # Its bytes
    is_key: bool  # Whether decoding can begin with it
    frame_id: str  # Camera optical frame


def missing_decoder() -> str:
    """Why video cannot be decoded on this machine and what to do; empty if it can."""
    if find_spec("av") is not None:
        return ""
    return "it is video, which needs PyAV: pip install 'lidcam[video]'"


@decoder
def read_packet(message: RawMessage) -> VideoPacket:
    """The packet of a CompressedVideo or FFMPEGPacket, undecoded."""
    fields, is_ffmpeg = deserialize(message), message.channel.msgtype == FFMPEG_PACKET
    named = str(fields.encoding if is_ffmpeg else fields.format)
    frame_id = clean_frame(fields.header.frame_id if is_ffmpeg else fields.frame_id)
    data, is_flagged = np.asarray(fields.data), is_ffmpeg and bool(int(fields.flags) & KEY_FLAG)
    codec = _codec_of(named)
    if codec is None:
        raise MessageError(f"{message.topic}: video of format {named[:50]!r}; expected one of {', '.join(_NAMES)}")
    if data.dtype != np.uint8 or not data.size:
        raise MessageError(f"{message.topic}: {named[:50]} video without data")
    return VideoPacket(codec, data, _is_key(codec, data, is_flagged), frame_id)


def _codec_of(named: str) -> str | None:
    name = named.split(";")[0].strip().lower()
    return next((codec for codec, names in _NAMES.items() if names.fullmatch(name)), None)


def is_video_image(message: RawMessage) -> bool:
    """Whether a message is a CompressedImage that holds a packet, as nodes with a hardware encoder publish them."""
    if message.channel.msgtype != COMPRESSED_IMAGE:
        return False
    try:
        return _codec_of(deserialize(message).format) not in {None, "mjpeg"}  # an image of MJPEG is a JPEG
    except MessageError:
        return False


def video_channel(channel: Channel) -> Channel:
    """The channel of the messages of a channel after `as_video`."""
    return Channel(channel.topic, COMPRESSED_VIDEO, "cdr", ROS2.definition(COMPRESSED_VIDEO), "ros2msg")


def as_video(message: RawMessage) -> RawMessage:
    """A CompressedImage with a packet as a CompressedVideo; with a `problem` if it cannot be decoded."""
    channel = video_channel(message.channel)
    try:
        image = deserialize(message)
    except MessageError as err:
        return message._replace(data=b"", channel=channel, problem=str(err).removeprefix(f"{message.topic}: "))
    fields = {"timestamp": image.header.stamp, "frame_id": image.header.frame_id}
    video = ROS2.new(COMPRESSED_VIDEO, **fields, data=image.data, format=image.format)
    return message._replace(data=ROS2.serialize(video), channel=channel)


def begins_video(packet: VideoPacket) -> bool:
    """Whether a viewer can begin with a packet: more than a key frame, it has all that its decoder must know."""
    return packet.is_key and all(unit.search(packet.data.data) for unit in _FIRST_UNITS.get(packet.codec, ()))


def _is_key(codec: str, data: U8, is_flagged: bool) -> bool:
    """Whether decoding can begin here, by the bitstream; for MPEG-4 by the flag of the message."""
    first = int(data[0])
    match codec:
        case "h264" | "hevc":
            return _KEY_UNITS[codec].search(data.data) is not None
        case "vp9":  # frame marker, profile (3 has a bit more), show_existing_frame, frame_type
            shift = 1 if first >> 4 & 3 == 3 else 2
            return first >> 6 == 2 and first >> shift & 3 == 0
        case "vp8":
            return first & 1 == 0
        case "av1":
            head = data[:3].tobytes().removeprefix(_TEMPORAL_DELIMITER)
            return bool(head) and head[0] >> 3 & 15 == _SEQUENCE_HEADER
        case "mjpeg":
            return True
        case _:
            return is_flagged
