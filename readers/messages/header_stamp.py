"""The header stamp from the first bytes of a message: synchronisation needs stamps before messages are decoded."""

import struct
from functools import lru_cache

from rosbags.interfaces import Nodetype

from pipeline.core.errors import MessageError
from pipeline.core.messages import Channel
from readers.messages.cursor import Cursor
from readers.messages.deserialize import typestore_for

__all__ = ["peek_stamp_ns", "stamp_or_log_time"]

HEADER = "std_msgs/msg/Header"
TIMESTAMP = "timestamp", "builtin_interfaces/msg/Time"
"""First field of foxglove_msgs, in place of a header."""


def peek_stamp_ns(channel: Channel, data: bytes | memoryview) -> int | None:
    """Stamp of the std_msgs/Header that the message starts with, in nanoseconds.

    None where the type does not start with a header, its definition cannot be used, or the data are too short. The
    last two fail again, and are counted, when the message is decoded. None also for protobuf and JSON, whose stamps
    `foxglove.to_ros` reads.
    """
    skipped = _numbers_before_stamp(channel)
    if skipped is None:
        return None
    cursor = Cursor(data, channel.encoding)
    cursor.skip(4, skipped)
    if len(data) < cursor.at + 8:
        return None
    layout = f"{cursor.order}{'II' if channel.encoding == 'ros1' else 'iI'}"
    sec, nanosec = struct.unpack_from(layout, data, cursor.at)
    return int(sec) * 10**9 + int(nanosec)


def stamp_or_log_time(channel: Channel, data: bytes | memoryview, log_time_ns: int) -> int:
    """`RawMessage.stamp_ns`: the header stamp, or the log time where `peek_stamp_ns` finds none."""
    stamp_ns = peek_stamp_ns(channel, data)
    return log_time_ns if stamp_ns is None else stamp_ns


@lru_cache(maxsize=1024)
def _numbers_before_stamp(channel: Channel) -> int | None:
    """How many uint32 a message has before its stamp; None where the type does not start with a stamp or header."""
    try:
        fielddefs = typestore_for(channel).fielddefs
    except MessageError:
        return None
    fields = fielddefs[channel.msgtype][1]
    if fields and (fields[0][0], fields[0][1][1]) == TIMESTAMP:
        return 0
    starts_with_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)
    if channel.msgtype != HEADER and not starts_with_header:
        return None
    names = [name for name, _ in fielddefs[HEADER][1]]
    return names.index("stamp") if "stamp" in names[:2] else None  # ROS 1 puts seq (uint32) before it
