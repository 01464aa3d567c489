"""Recorded images as ROS 2 messages: the pixels are never decoded, only the header changes."""

from typing import Any

from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.ros.typestores import message_types

COMPRESSED = "sensor_msgs/msg/CompressedImage"
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


def image_cdr(message: RawMessage, *, frame_id: str) -> bytes | memoryview:
    """The image as little-endian CDR with the message's stamp and the given frame in its header.

    A message that already has that form is passed through unchanged.

    Raises:
        MessageError: it is no image, or the bytes do not fit its type.
    """
    image, header = read_image(message), ROS2.header(message.stamp_ns, frame_id)
    if message.channel.encoding == "cdr" and message.data[1] == 1 and image.header == header:
        return message.data
    image.header = header
    return ROS2.serialize(image)
