"""Recorded images as ROS 2 messages: the pixels are never decoded, only the header changes."""

import struct
from functools import lru_cache
from typing import Any

from pipeline.core.errors import MessageError, is_short_memory
from pipeline.core.messages import RawMessage
from pipeline.core.ros.columns import Columns
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.typestores import message_types
from writers.messages.image_parts import CompressedImage, split_compressed
from writers.messages.parts import header

__all__ = ["COMPRESSED", "image_cdr", "read_image"]

COMPRESSED = "sensor_msgs/msg/CompressedImage"
_LENGTH = struct.Struct("<I")  # of an array

IMAGE_TYPES = ("sensor_msgs/msg/Image", COMPRESSED)


def read_image(message: RawMessage) -> Any:
    """The recorded image, with its `data` a view into the message.

    Raises:
        MessageError: the type is another one, the bytes do not fit it, or the message could not be read.
    """
    msgtype, is_ros1 = message.channel.msgtype, message.channel.encoding == "ros1"
    if msgtype not in IMAGE_TYPES:
        raise MessageError(f"{message.topic}: expected {' or '.join(IMAGE_TYPES)}, found {msgtype}")
    if message.problem:
        raise MessageError(f"{message.topic}: {message.problem}")
    types = message_types(1 if is_ros1 else 2)
    try:
        return (types.deserialize_ros1 if is_ros1 else types.deserialize_cdr)(memoryview(message.data), msgtype)
    except Exception as err:  # rosbags' generated decoders raise errors of several kinds
        if is_short_memory(err):
            raise
        raise MessageError(f"{message.topic}: {len(message.data)} bytes are not a valid {msgtype} ({err})") from err


def image_cdr(message: RawMessage, *, frame_id: str) -> tuple[bytes | memoryview, ...]:
    """The image as little-endian CDR with the message's stamp and the given frame in its header, in parts.

    A message that already has that form is passed through unchanged.

    Raises:
        MessageError: it is no image, or the bytes do not fit its type.
    """
    found = split_compressed(message) if message.channel.msgtype == COMPRESSED and not message.problem else None
    if found is not None:
        return _compressed_cdr(message, found, frame_id)
    image, header = read_image(message), ROS2.header(message.stamp_ns, frame_id)
    if message.channel.encoding == "cdr" and message.data[1] == 1 and image.header == header:
        return (message.data,)
    image.header = header
    return ROS2.serialize_large(image)


def _compressed_cdr(message: RawMessage, found: CompressedImage, frame_id: str) -> tuple[bytes | memoryview, ...]:
    expected = divmod(message.stamp_ns, 10**9), frame_id.encode()
    if message.channel.encoding == "cdr" and (found.stamp, found.frame_id) == expected:
        return (message.data,)
    before = ROS2.restamped(_before_data(frame_id, found.format), message.stamp_ns)
    return before + _LENGTH.pack(len(found.data)), found.data


@lru_cache(maxsize=256)  # a frame and a format of each camera
def _before_data(frame_id: str, kind: bytes) -> bytes:
    """The bytes of a CompressedImage up to the length of its data, with a stamp of 0."""
    empty = Columns(COMPRESSED, header=header(0, frame_id), format=kind.decode())
    return bytes(ROS2.serialize(empty)[: -_LENGTH.size])
