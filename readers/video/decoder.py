"""Decodes the packets of one video topic. The only reader that imports PyAV (extra `video`).

An image depends on those before it, so a decoder must get every packet of its topic in order. It begins with a key
frame; after a packet that cannot be decoded it waits for the next key frame, because codecs make up missing images.
Decoding runs on one thread: the same packets give the same images.
"""

import re
from collections import deque
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
from av.codec.context import Flags

from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.messages import Channel, RawMessage, VideoPart, time_fault
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.image import COMPRESSED_IMAGE
from lidcam.readers.video.packets import AFTER_DAMAGE, BEFORE_KEY_FRAME, VideoPacket, begins_video, read_packet

_PARAMETERS = re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]")
_SLICE = re.compile(rb"\x00\x00\x01[\x01\x05\x21\x25\x41\x45\x61\x65]")
_IDR = 5
_ESCAPED = re.compile(rb"\x00\x00\x03")
_WITH_CHROMA_FORMAT = frozenset({100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135})
_HEAD_BYTES = 64
"""Bytes of a unit that are read; the fields are in the first few."""


class GapFinder:
    """Detects missing packets of H.264, from a key frame on: decoders do not report them and show made-up images.

    Source: ITU-T H.264, 7.3.2.1.1 (sequence parameter set), 7.3.3 (slice header), 7.4.3 (`frame_num`). `frame_num`
    counts reference images only; a missing image that no other refers to goes unnoticed and does no harm.
    """

    def __init__(self) -> None:
        self._digits: int | None = None
        self._reference = -1

    def gap_before(self, data: memoryview, *, is_key: bool) -> str:
        """Take the next packet; says what is missing before it, or is empty."""
        if (parameters := _PARAMETERS.search(data)) is not None:
            self._digits = _frame_num_digits(_Bits(data, parameters.end()))
        piece = _SLICE.search(data)
        if piece is None or self._digits is None:
            return ""
        kind, is_reference = data[piece.end() - 1] & 31, bool(data[piece.end() - 1] >> 5)
        bits = _Bits(data, piece.end())
        bits.skip_codes(3)  # first_mb_in_slice, slice_type, pic_parameter_set_id
        number = 0 if kind == _IDR else bits.read(self._digits)
        before, self._reference = self._reference, number if is_reference or self._reference < 0 else self._reference
        following = (before + 1) % (1 << self._digits)
        if is_key or before < 0 or number in {before, following}:
            return ""
        return f"a packet before it is missing, or this one is broken: it has number {number}, expected {following}"


class _Bits:
    """Bits of a unit from `start` on, without emulation prevention bytes; zeros after its end."""

    def __init__(self, data: memoryview, start: int) -> None:
        content = _ESCAPED.sub(b"\0\0", bytes(data[start : start + _HEAD_BYTES]))
        self._value, self._left = int.from_bytes(content, "big"), 8 * len(content)

    def read(self, count: int) -> int:
        self._left -= count
        value = self._value >> self._left if self._left >= 0 else self._value << -self._left
        return value & ((1 << count) - 1)

    def code(self) -> int:
        """Read an unsigned Exp-Golomb code, 9.1."""
        zeros = 0
        while zeros < 32 and not self.read(1):
            zeros += 1
        return (1 << zeros) - 1 + self.read(zeros)

    def skip_codes(self, count: int) -> None:
        for _ in range(count):
            self.code()


def _frame_num_digits(bits: _Bits) -> int | None:
    """Length of `frame_num` in bits; None if the parameter set allows gaps or uses features not parsed here."""
    profile = bits.read(8)
    bits.read(16)
    bits.skip_codes(1)  # seq_parameter_set_id
    if profile in _WITH_CHROMA_FORMAT:
        if bits.code() == 3:  # 4:4:4: may code the colours separately
            return None
        bits.skip_codes(2)  # bit depths
        if bits.read(2) & 1:  # scaling matrices
            return None
    digits = bits.code() + 4
    match bits.code():  # pic_order_cnt_type
        case 0:
            bits.skip_codes(1)
        case 1:
            return None
    bits.skip_codes(1)  # max_num_ref_frames
    allows_gaps = bits.read(1)
    return None if allows_gaps or digits > 16 else digits


MAX_KEPT_BYTES = 64 << 20
"""Bytes of packets of one video that wait for a frame; beyond these, packets are kept from the next key frame on."""


class _Kept(NamedTuple):
    image: tuple[object, ...]  # Of which image the packet is
    codec: str
    data: bytes
    begins: bool  # Whether a viewer can begin with it


class KeptPackets:
    """The decoded packets of one video since the last one that went with a frame, for viewers that decode video."""

    def __init__(self) -> None:
        self._waiting: deque[_Kept] = deque()
        self._bytes = 0
        self._goes_on, self._is_in_order = False, True

    def add(self, packet: VideoPacket, message: RawMessage) -> None:
        """Keep a packet whose image is decoded, unless one before it is missing."""
        begins = begins_video(packet)
        self._goes_on |= begins and self._is_in_order
        if self._goes_on:
            self._waiting.append(_Kept(_image_of(message), packet.codec, packet.data.tobytes(), begins))
            self._bytes += len(packet.data)
        if self._bytes > MAX_KEPT_BYTES:
            self._waiting.clear()
            self._bytes, self._goes_on = 0, False

    def interrupt(self) -> None:
        """Take note that a packet is missing: none is kept before the next with which a viewer can begin."""
        self._goes_on = False

    def give_up(self) -> None:
        """Take note that images are not in the order of their packets, which no viewer is told of: none is kept."""
        self._goes_on = self._is_in_order = False
        self._waiting.clear()

    def take(self, message: RawMessage) -> VideoPart | None:
        """The packets up to that of an image, from the last that a viewer can begin with; None if that is missing."""
        image = _image_of(message)
        if all(kept.image != image for kept in self._waiting):
            return None
        taken: list[_Kept] = []
        while not taken or taken[-1].image != image:
            kept = self._waiting.popleft()
            self._bytes -= len(kept.data)
            taken = [kept] if kept.begins else [*taken, kept]
        return VideoPart(taken[-1].codec, tuple(kept.data for kept in taken))


def _image_of(message: RawMessage) -> tuple[object, ...]:
    return message.log_time_ns, message.order  # stamps are corrected where a clock is off


MAX_PIXELS = 1 << 25
"""Size of an image, a little over 8K: a decoder keeps up to 17 of them, as large as the first packet claims."""

MAX_HELD = 32
"""Packets that may wait for their images: H.264 and H.265 reorder at most 16."""

JPEG_QUALITY = 95

_DECODERS = {"av1": "libdav1d"}  # FFmpeg's own needs a graphics card


class VideoDecoder:
    """Turns the messages of one topic into sensor_msgs/CompressedImage, each with its own stamp, frame and log time.

    The images are JPEG, to stay small while they wait for the other sensors. A message that gives no image is returned
    without data and with the reason as its `problem`: `BEFORE_KEY_FRAME`, `AFTER_DAMAGE`, or what is wrong with it.
    With B-frames messages are returned later, each with the image of its packet.

    Attributes:
        kept: The packets themselves.
    """

    def __init__(self, topic: str, *, limits: RecordingLimits = DEFAULT_LIMITS) -> None:
        self._channel = Channel(topic, COMPRESSED_IMAGE, "cdr", ROS2.definition(COMPRESSED_IMAGE), "ros2msg")
        self._max_pixels = min(MAX_PIXELS, round(limits.max_image_mpx * 1e6))
        self._codec = ""
        self._context: Any = None
        self._gaps = GapFinder()
        self._waits = BEFORE_KEY_FRAME
        self._count = 0
        self._held: dict[int, tuple[RawMessage, str] | None] = {}
        self.kept = KeptPackets()

    def add_message(self, message: RawMessage, *, show: bool = True) -> list[RawMessage]:
        """Take the next message; returns the messages that are done, in the order of their images.

        One that is not to be shown only serves to decode those after it.
        """
        try:
            packet = read_packet(message)
        except MessageError as err:
            return [*self.flush(damaged=True), *self._blank(message, str(err), show)]
        done: list[RawMessage] = []
        if packet.codec != self._codec:
            done += self.flush()
            self._codec = packet.codec
        if self._context is None:
            if not packet.is_key:
                return [*done, *self._blank(message, self._waits, show)]
            self._context, self._gaps = _open(packet.codec, self._max_pixels), GapFinder()
        if packet.codec == "h264" and (gap := self._gaps.gap_before(packet.data.data, is_key=packet.is_key)):
            return [*done, *self.flush(damaged=True), *self._blank(message, gap, show)]
        self._count += 1
        self._held[self._count] = (message, packet.frame_id) if show else None
        try:
            done += self._decode(packet)
        except av.error.FFmpegError as err:
            if is_short_memory(err):
                raise
            held = self._held.pop(self._count, None)
            done += self.flush(damaged=True)
            problem = f"{len(packet.data)} bytes are not valid {packet.codec} ({err.strerror})"
            return [*done, *self._blank(message, problem, held is not None)]
        if self._held:
            self.kept.give_up()
        else:
            self.kept.add(packet, message)
        limit = MAX_HELD if self._context.has_b_frames else 0
        return done + self._give_up(max(len(self._held) - limit, 0))

    def _decode(self, packet: VideoPacket) -> list[RawMessage]:
        coded = av.Packet(packet.data.tobytes())
        coded.pts = coded.dts = self._count
        return [image for frame in self._context.decode(coded) for image in self._taken(frame)]

    def _taken(self, frame: Any) -> list[RawMessage]:
        """The message of a decoded frame, with its image."""
        held = self._held.pop(frame.pts, None)
        if held is None:
            return []
        message, frame_id = held
        try:
            data = _image(frame, message.stamp_ns, frame_id)
        except (cv2.error, av.error.FFmpegError, ValueError) as err:
            if is_short_memory(err):
                raise
            reason = one_line(err)
            return self._blank(message, f"a {frame.width} x {frame.height} px image cannot become a JPEG ({reason})")
        return [message._replace(data=data, channel=self._channel)]

    def flush(self, *, damaged: bool = False) -> list[RawMessage]:
        """Close the decoder at the end of a stream; returns the messages left. The next one begins with a key frame."""
        self.kept.interrupt()
        if self._context is None:
            return []
        try:
            done = [image for frame in self._context.decode(None) for image in self._taken(frame)]
        except av.error.FFmpegError as err:
            if is_short_memory(err):
                raise
            done = []
        self._context = None
        self._waits = AFTER_DAMAGE if damaged else self._waits
        return done + self._give_up(len(self._held))

    def _give_up(self, count: int) -> list[RawMessage]:
        """The messages that have waited longest, without images."""
        given_up = [self._held.pop(key) for key in list(self._held)[:count]]
        return [blank for held in given_up if held for blank in self._blank(held[0], "its packet gave no image")]

    def _blank(self, message: RawMessage, problem: str, show: bool = True) -> list[RawMessage]:
        return [message._replace(data=b"", channel=self._channel, problem=problem)] if show else []


def _open(codec: str, max_pixels: int) -> Any:
    context = av.CodecContext.create(_DECODERS.get(codec, codec), "r")
    context.thread_count = 1
    context.flags |= Flags.low_delay
    context.options = {"max_pixels": str(max_pixels), "err_detect": "crccheck+bitstream+buffer+explode"}
    return context


def _image(frame: Any, stamp_ns: int, frame_id: str) -> bytes:
    """A frame as sensor_msgs/CompressedImage."""
    bgr = frame.to_ndarray(format="bgr24")
    done, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise ValueError("too large")
    stamp_ns = 0 if time_fault(stamp_ns) else stamp_ns
    return ROS2.serialize(ROS2.compressed_image(stamp_ns, frame_id, "jpeg", np.asarray(jpeg, np.uint8).reshape(-1)))
