"""The fields of recorded images, found without an object for each: a frame may have eight images."""

import struct
from typing import NamedTuple

from pipeline.core.messages import RawMessage

__all__ = ["CompressedImage", "split_compressed"]

_LENGTH, _STAMP = struct.Struct("<I"), struct.Struct("<iI")
_CDR_HEAD, _ROS1_SEQ = b"\0\1\0\0", 4


class CompressedImage(NamedTuple):
    """A recorded sensor_msgs/CompressedImage.

    Attributes:
        stamp: Seconds and nanoseconds of its header.
        frame_id: The same.
        format: As it was recorded.
        data: A view of the picture's bytes.
    """

    stamp: tuple[int, int]
    frame_id: bytes
    format: bytes
    data: memoryview


def split_compressed(message: RawMessage) -> CompressedImage | None:
    """The fields of ROS 1 bytes or of little-endian CDR that are whole to the last byte; None of others."""
    raw, is_ros1 = memoryview(message.data), message.channel.encoding == "ros1"
    if not is_ros1 and bytes(raw[:4]) != _CDR_HEAD:
        return None
    begin, nul = (0, 0) if is_ros1 else (len(_CDR_HEAD), 1)  # texts of CDR end with a zero
    try:
        place = begin + (_ROS1_SEQ if is_ros1 else 0)
        sec, nanosec = _STAMP.unpack_from(raw, place)
        place += _STAMP.size
        texts = []
        for _ in range(2):
            (length,) = _LENGTH.unpack_from(raw, place)
            place += _LENGTH.size + length
            text = bytes(raw[place - length : place])
            if len(text) != length or length < nul or text[length - nul :] != bytes(nul) or not text.isascii():
                return None
            texts.append(text[: length - nul])
            place += 0 if is_ros1 else -(place - begin) % _LENGTH.size
        (length,) = _LENGTH.unpack_from(raw, place)
    except struct.error:
        return None
    data = raw[place + _LENGTH.size :]
    return CompressedImage((sec, nanosec), texts[0], texts[1], data) if len(data) == length else None
