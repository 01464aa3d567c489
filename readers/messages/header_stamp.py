"""The header stamp from the first bytes of a message: synchronisation needs stamps before messages are decoded."""

import struct
from functools import lru_cache

from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel
from lidcam.readers.messages.deserialize import typestore_for

HEADER = "std_msgs/msg/Header"
TIMESTAMP = "timestamp", "builtin_interfaces/msg/Time"
"""First field of foxglove_msgs, in place of a header."""

STAMP_BYTES, SEQ_BYTES, ENCAPSULATION_BYTES = 8, 4, 4
ROS1_STAMP = struct.Struct("<II")
CDR_STAMP = struct.Struct(">iI"), struct.Struct("<iI")  # by the lowest bit of the encapsulation's second byte


def stamp_or_log_time(channel: Channel, data: bytes | memoryview, log_time_ns: int) -> int:
    """`RawMessage.stamp_ns`: the stamp of the std_msgs/Header that a message starts with, else its log time.

    The log time stands where the type does not start with a header, its definition cannot be used, or the data are too
    short; the last two fail again, and are counted, when the message is decoded. Also for protobuf and JSON, whose
    stamps `foxglove.to_ros` reads.
    """
    place = _place_of_stamp(channel)
    if place is None or len(data) < place + STAMP_BYTES:
        return log_time_ns
    layout = ROS1_STAMP if channel.encoding == "ros1" else CDR_STAMP[data[1] & 1]
    sec, nanosec = layout.unpack_from(data, place)
    return int(sec) * 10**9 + int(nanosec)


@lru_cache(maxsize=1024)
def _place_of_stamp(channel: Channel) -> int | None:
    """The first byte of a message's stamp; None where the type does not start with a stamp or header."""
    try:
        fielddefs = typestore_for(channel).fielddefs
    except MessageError:
        return None
    begin = 0 if channel.encoding == "ros1" else ENCAPSULATION_BYTES
    fields = fielddefs[channel.msgtype][1]
    if fields and (fields[0][0], fields[0][1][1]) == TIMESTAMP:
        return begin
    starts_with_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)
    if channel.msgtype != HEADER and not starts_with_header:
        return None
    names = [name for name, _ in fielddefs[HEADER][1][:2]]
    return begin + SEQ_BYTES * names.index("stamp") if "stamp" in names else None  # ROS 1 puts seq before it
