"""velodyne_msgs/VelodynePacket, one message per UDP packet, and the VelodyneScan that a run of them makes.

Neither direction decodes: the 1214 bytes of stamp and payload lie in both messages alike, little endian.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache

from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.cursor import Cursor
from lidcam.readers.messages.deserialize import typestore_for
from lidcam.readers.velodyne.scan import PACKET_BYTES, SCAN

PACKET = "velodyne_msgs/msg/VelodynePacket"

STAMPED_BYTES = 8 + PACKET_BYTES
"""Bytes of a packet and the stamp before it."""

_CDR_LITTLE_ENDIAN = b"\0\1\0\0"


def packet_channel(topic: str) -> Channel:
    """A channel of VelodynePackets that were recorded without ROS."""
    return Channel(topic, PACKET, "cdr", ROS2.definition(PACKET))


def scan_channel(topic: str) -> Channel:
    """The channel of the scans gathered from a topic's packets."""
    return Channel(topic, SCAN, "cdr", ROS2.definition(SCAN))


def packet_message_data(stamp_ns: int, payload: bytes | memoryview) -> bytes:
    """A VelodynePacket of `packet_channel`."""
    return _CDR_LITTLE_ENDIAN + struct.pack("<II", *divmod(stamp_ns, 10**9)) + payload


def packet_data(message: RawMessage) -> bytes | memoryview:
    """Stamp and payload of a VelodynePacket as `scan_data` takes them; `packet_problem` must be empty.

    Raises:
        MessageError: its bytes are not there, or end too soon.
    """
    data = message.data
    if message.problem:
        raise MessageError(f"{message.topic}: {message.problem}")
    cursor = Cursor(data, message.channel.encoding)
    start, end = cursor.at, cursor.at + STAMPED_BYTES
    if len(data) < end:
        raise MessageError(f"{message.topic}: expected a {PACKET} of {end} bytes, found {len(data)} bytes")
    if cursor.order == ">":
        return struct.pack("<II", *struct.unpack_from(">II", data, start)) + data[start + 8 : end]
    return data[start:end]


def scan_data(packets: Sequence[bytes | memoryview]) -> bytes:
    """A VelodyneScan of `scan_channel`: its header has the first packet's stamp, and no frame.

    Args:
        packets: Stamp and payload of each, at least one.
    """
    head = _CDR_LITTLE_ENDIAN + packets[0][:8] + struct.pack("<I4xI", 1, len(packets))  # an empty name ends in a zero
    return head + b"\0\0".join(packets)


@lru_cache(maxsize=256)
def packet_problem(channel: Channel) -> str:
    """Why the VelodynePackets of a channel cannot be used; empty if they can."""
    try:
        fields = typestore_for(channel).fielddefs[PACKET][1]
    except MessageError as err:
        return str(err).removeprefix(f"{channel.topic}: ")
    known = [
        ("stamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")),
        ("data", (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), PACKET_BYTES))),
    ]
    return "" if fields == known else f"its definition of {PACKET} is not a stamp and uint8[{PACKET_BYTES}]"
