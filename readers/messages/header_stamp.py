"""The header stamp from the first bytes of a message: sync works on messages that nobody has decoded yet."""

import struct
from functools import lru_cache

from rosbags.interfaces import Nodetype

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel
from readers.messages.deserialize import typestore_for

__all__ = ["peek_stamp_ns", "stamp_or_log_time"]

HEADER = "std_msgs/msg/Header"
TIMESTAMP = "timestamp", "builtin_interfaces/msg/Time"
"""What foxglove_msgs have instead of a header."""
CDR_ENCAPSULATION_BYTES = 4


def peek_stamp_ns(channel: Channel, data: bytes | memoryview) -> int | None:
    """Stamp of the std_msgs/Header that the message starts with, in nanoseconds.

    None where the type starts with no header, its definition cannot be used, or the data are too short to hold one.
    The last two cannot be decoded either: they are counted there, where every message that is used passes. None, too,
    for protobuf and JSON: `foxglove.to_ros` tells their stamps.
    """
    layout = _stamp_layout(channel)
    if layout is None:
        return None
    offset, little_endian, big_endian = layout
    if len(data) < offset + little_endian.size:
        return None
    # OMG DDSI-RTPS 10.2: the lowest bit of the encapsulation identifier says little endian; ROS 1 always is.
    stamp = big_endian if channel.encoding == "cdr" and not data[1] & 1 else little_endian
    sec, nanosec = stamp.unpack_from(data, offset)
    return int(sec) * 10**9 + int(nanosec)


def stamp_or_log_time(channel: Channel, data: bytes | memoryview, log_time_ns: int) -> int:
    """`RawMessage.stamp_ns`: the header stamp, or the log time where `peek_stamp_ns` finds none."""
    stamp_ns = peek_stamp_ns(channel, data)
    return log_time_ns if stamp_ns is None else stamp_ns


@lru_cache(maxsize=1024)
def _stamp_layout(channel: Channel) -> tuple[int, struct.Struct, struct.Struct] | None:
    """Offset of the stamp and its layout in little and big endian; None where the type starts with no header."""
    try:
        fielddefs = typestore_for(channel).fielddefs
    except MessageError:
        return None
    fields = fielddefs[channel.msgtype][1]
    if fields and (fields[0][0], fields[0][1][1]) == TIMESTAMP:
        return _stamp_at(0, channel)
    starts_with_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)
    if channel.msgtype != HEADER and not starts_with_header:
        return None
    names = [name for name, _ in fielddefs[HEADER][1]]
    if "stamp" not in names[:2]:
        return None
    return _stamp_at(4 * names.index("stamp"), channel)  # ROS 1 puts seq (uint32) before it


def _stamp_at(offset: int, channel: Channel) -> tuple[int, struct.Struct, struct.Struct]:
    """The layout of a stamp that lies at this place behind the encapsulation."""
    if channel.encoding == "ros1":
        return offset, struct.Struct("<II"), struct.Struct(">II")
    return CDR_ENCAPSULATION_BYTES + offset, struct.Struct("<iI"), struct.Struct(">iI")
