"""Recorded images as ROS 2 messages: the payload is never decoded, only the fields around it are laid out anew."""

import struct
from typing import NamedTuple

from pipeline.core.errors import MessageError
from pipeline.core.messages import RawMessage
from writers.messages.cdr import CdrEncoder

__all__ = ["COMPRESSED", "IMAGE_TYPES", "RAW", "Image", "image_cdr", "read_image"]

RAW = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
IMAGE_TYPES = (RAW, COMPRESSED)


class Image(NamedTuple):
    """The fields of sensor_msgs/Image or sensor_msgs/CompressedImage.

    Attributes:
        stamp_ns: Stamp of the recorded header.
        frame_id: Frame of the recorded header.
        height_px: 0 if compressed.
        width_px: 0 if compressed.
        encoding: Pixel encoding; if compressed the format (`jpeg`, `png` or a longer description).
        is_bigendian: Byte order of the pixels.
        step_bytes: Length of a row; 0 if compressed.
        data: View of the payload inside the recorded message.
    """

    stamp_ns: int
    frame_id: str
    height_px: int
    width_px: int
    encoding: str
    is_bigendian: int
    step_bytes: int
    data: memoryview


class _Fields:
    """Reads field after field; ROS 1 packs them, CDR aligns numbers to their size."""

    def __init__(self, message: RawMessage) -> None:
        data = memoryview(message.data)
        self._order, self._cdr = "<", message.channel.encoding == "cdr"
        if self._cdr:
            self._order = "<" if data[1] & 1 else ">"
            data = data[4:]
        self._data, self._at = data, 0

    def u8(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def u32(self) -> int:
        if self._cdr:
            self._at += -self._at % 4
        (value,) = struct.unpack_from(f"{self._order}I", self._data, self._at)
        self._at += 4
        return int(value)

    def byte_sequence(self) -> memoryview:
        length = self.u32()
        data = self._data[self._at : self._at + length]
        if len(data) < length:
            raise ValueError(f"{length} bytes announced, {len(data)} left")
        self._at += length
        return data

    def string(self) -> str:
        encoded = bytes(self.byte_sequence())
        return (encoded.removesuffix(b"\0") if self._cdr else encoded).decode()


def read_image(message: RawMessage) -> Image:
    """The fields of a recorded image, ROS 1 or CDR of either byte order; the payload is not copied.

    Raises:
        MessageError: the type is another one, the bytes do not fit it, or the message could not be read.
    """
    msgtype = message.channel.msgtype
    if msgtype not in IMAGE_TYPES:
        raise MessageError(f"{message.topic}: expected {' or '.join(IMAGE_TYPES)}, found {msgtype}")
    if message.problem:
        raise MessageError(f"{message.topic}: {message.problem}")
    try:
        fields = _Fields(message)
        if message.channel.encoding == "ros1":
            fields.u32()  # Header.seq
        stamp_ns = fields.u32() * 10**9 + fields.u32()
        frame_id = fields.string()
        if msgtype == COMPRESSED:
            return Image(stamp_ns, frame_id, 0, 0, fields.string(), 0, 0, fields.byte_sequence())
        height, width, encoding = fields.u32(), fields.u32(), fields.string()
        return Image(stamp_ns, frame_id, height, width, encoding, fields.u8(), fields.u32(), fields.byte_sequence())
    except (struct.error, IndexError, ValueError) as err:
        raise MessageError(f"{message.topic}: {len(message.data)} bytes are no {msgtype} ({err})") from err


def image_cdr(message: RawMessage, *, frame_id: str) -> bytes | bytearray | memoryview:
    """The image as little-endian CDR with the message's stamp and the given frame in its header.

    A message that has that form already is handed through as it is.

    Raises:
        MessageError: it is no image, or the bytes do not fit its type.
    """
    image = read_image(message)
    cdr = message.channel.encoding == "cdr"
    if cdr and message.data[1] == 1 and (image.stamp_ns, image.frame_id) == (message.stamp_ns, frame_id):
        return message.data
    encoder = CdrEncoder().header(message.stamp_ns, frame_id)
    if message.channel.msgtype == COMPRESSED:
        encoder.string(image.encoding)
    else:
        encoder.u32(image.height_px, image.width_px).string(image.encoding)
        encoder.u8(image.is_bigendian).u32(image.step_bytes)
    return encoder.byte_sequence(image.data).buffer
