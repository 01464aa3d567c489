"""Videos for tests: images, PyAV's encoders, and the messages that recorders make of their packets."""

import os
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Literal, NamedTuple

import av
import cv2
import numpy as np
from builders import header, raw, time

from lidcam.pipeline.core.arrays import U8
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.image import decode_any_image

os.environ.setdefault("SVT_LOG", "0")  # or the encoder of AV1 tells of itself on stderr


T0 = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000

X265 = "bframes=0:scenecut=0:log-level=none:pools=none:frame-threads=1:repeat-headers=1"
# Codec, encoder and its options by Foxglove's name: one packet per image, none out of order.
CODECS: dict[str, tuple[str, str, dict[str, str]]] = {
    "h264": ("h264", "libx264", {"preset": "veryfast", "tune": "zerolatency", "sc_threshold": "0"}),
    "h265": ("hevc", "libx265", {"preset": "ultrafast", "x265-params": X265}),
    "vp9": ("vp9", "libvpx-vp9", {"deadline": "realtime", "cpu-used": "8", "lag-in-frames": "0"}),
    "av1": ("av1", "libsvtav1", {"preset": "11", "crf": "20", "svtav1-params": "pred-struct=1"}),
    "vp8": ("vp8", "libvpx", {"deadline": "realtime", "cpu-used": "8", "lag-in-frames": "0"}),
    "mpeg4": ("mpeg4", "mpeg4", {}),
    "mjpeg": ("mjpeg", "mjpeg", {}),
}


class Packet(NamedTuple):
    """One packet: its bytes, the number of its image, and whether the encoder calls it a key frame."""

    data: bytes
    image: int
    is_key: bool


def moving(count: int, width_px: int = 64, height_px: int = 48) -> list[U8]:
    """Smooth RGB images with something that moves: each differs clearly from the one before."""
    y, x = np.mgrid[:height_px, :width_px]
    found = []
    for number in range(count):
        grey = 128 + 60 * np.sin((x + 2 * y) / 25 + number / 2)
        tint = 20 * np.sin(np.stack([x, y, x + y], -1) / 40)  # codecs halve the resolution of colours
        image = np.ascontiguousarray((grey[..., None] + tint).astype(np.uint8))
        center = (8 + 3 * number % (width_px - 16), height_px // 2)
        found.append(np.asarray(cv2.circle(image, center, 8, (240, 240, 240), -1), np.uint8))
    return found


def encode(images: Sequence[U8], kind: str = "h264", *, gop: int = 5, **options: str) -> list[Packet]:
    """The packets of RGB images in the order of decoding."""
    _, encoder, defaults = CODECS[kind]
    context: Any = av.CodecContext.create(encoder, "w")
    context.height, context.width = images[0].shape[:2]
    context.pix_fmt = "yuvj420p" if kind == "mjpeg" else "yuv420p"
    context.time_base, context.framerate = Fraction(1, 10), Fraction(10)
    context.gop_size, context.thread_count = gop, 1
    if kind in {"vp9", "vp8", "mpeg4", "mjpeg"}:  # the others aim at a quality
        context.bit_rate = 4_000_000
    context.options = defaults | {name.replace("_", "-"): value for name, value in options.items()}
    packets: list[Any] = []
    # For the superuser, the encoder of AV1 makes the thread that calls it one of real time: all else would starve.
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    for number, image in enumerate(images):
        frame = av.VideoFrame.from_ndarray(image, format="rgb24")
        frame.pts = number
        packets += context.encode(frame)
    packets += context.encode(None)
    os.sched_setscheduler(0, policy, parameters)
    return [Packet(bytes(packet), packet.pts, packet.is_keyframe) for packet in packets]


def compressed_video(
    data: bytes,
    stamp_ns: int,
    log_time_ns: int | None = None,
    *,
    form: str = "h264",
    topic: str = "/camera/video",
    encoding: Literal["ros1", "cdr"] = "cdr",
    frame_id: str = "camera",
) -> RawMessage:
    """A foxglove_msgs/CompressedVideo."""
    fields = {"timestamp": time(stamp_ns), "frame_id": frame_id, "data": data, "format": form}
    return raw(topic, "foxglove_msgs/msg/CompressedVideo", fields, stamp_ns, log_time_ns, encoding)


def video_image(data: bytes, stamp_ns: int, form: str = "h264", encoding: Literal["ros1", "cdr"] = "cdr") -> RawMessage:
    """A sensor_msgs/CompressedImage with a packet."""
    fields = {"header": header(stamp_ns, "camera"), "format": form, "data": data}
    return raw("/camera/h264", "sensor_msgs/msg/CompressedImage", fields, stamp_ns, encoding=encoding)


def ffmpeg_packet(
    data: bytes,
    stamp_ns: int,
    log_time_ns: int | None = None,
    *,
    name: str = "h264",
    topic: str = "/camera/image_raw/ffmpeg",
    encoding: Literal["ros1", "cdr"] = "cdr",
    **fields: Any,
) -> RawMessage:
    """A ffmpeg_image_transport_msgs/FFMPEGPacket; `fields` are further ones of its own."""
    message = {"header": header(stamp_ns, "camera"), "encoding": name, "data": data, **fields}
    return raw(topic, "ffmpeg_image_transport_msgs/msg/FFMPEGPacket", message, stamp_ns, log_time_ns, encoding)


def foxglove(packets: Sequence[Packet], form: str = "h264", **options: Any) -> list[RawMessage]:
    """CompressedVideo of packets, stamped by their images, recorded one after another."""
    return [compressed_video(one.data, *_times(row, one), form=form, **options) for row, one in enumerate(packets)]


def ffmpeg(packets: Sequence[Packet], name: str = "h264", **options: Any) -> list[RawMessage]:
    """FFMPEGPacket of packets, stamped by their images, recorded one after another."""
    messages = []
    for row, one in enumerate(packets):
        fields = {"pts": 1000 * one.image, "flags": int(one.is_key), **options}
        messages.append(ffmpeg_packet(one.data, *_times(row, one), name=name, **fields))
    return messages


def _times(place: int, packet: Packet) -> tuple[int, int]:
    """Stamp and log time."""
    return T0 + packet.image * PERIOD_NS, T0 + place * PERIOD_NS + 1_000_000


def pixels(message: RawMessage) -> U8:
    """The RGB image of a message that came out of a decoder."""
    return decode_any_image(message).rgb


def psnr_db(one: U8, other: U8) -> float:
    """Peak signal-to-noise ratio of two images of one size; infinite where they are equal."""
    error = float(((one.astype(np.float64) - other) ** 2).mean())
    return float(10 * np.log10(255**2 / error)) if error else float("inf")
