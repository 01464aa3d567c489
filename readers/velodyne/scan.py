"""velodyne_msgs/VelodyneScan and VelodynePacket as bytes: the 1206 bytes of each packet are viewed where they lie.

The generic decoder takes 70 times as long: it makes an object of each packet. In CDR every stamp begins at a multiple
of four bytes, so the packets of a scan lie 1216 bytes apart, yet nothing fills up the last one; in ROS 1 they lie 1214
apart.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.arrays import I64, U8, Array, Bools
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.deserialize import cursor_of, damage_told, typestore_for
from lidcam.readers.messages.tf import clean_frame

SCAN = "velodyne_msgs/msg/VelodyneScan"
PACKET = "velodyne_msgs/msg/VelodynePacket"
PACKET_FIELDS = [
    ("stamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")),
    ("data", (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), 1206))),
]
"""Fields of a VelodynePacket, as rosbags has them."""

RANGES_PER_BLOCK = 32

_ECHO = np.dtype([("range", "<u2"), ("reflectivity", "u1")])
_BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("echoes", _ECHO, RANGES_PER_BLOCK)])
_PACKET = np.dtype([("blocks", _BLOCK, 12), ("clock_us", "<u4"), ("mode", "u1"), ("product", "u1")])
PACKET_BYTES = _PACKET.itemsize

_STAMPED_BYTES = 8 + PACKET_BYTES
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"


@dataclass(frozen=True, slots=True, eq=False)
class VelodynePackets:
    """The packets of one scan in recorded order."""

    frame_id: str  # Frame that the scan names
    stamps_ns: I64  # (P,) int64, the driver's time of each packet, of measurement or of arrival
    payload: U8  # (P, 1206) uint8, the bytes from the sensor; a view whose packets need not follow each other

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def fields(self) -> Array:
        """(P,) the same as records: twelve `blocks`, `clock_us` within the hour, and the bytes `mode` and `product`.

        A block has `flag`, `azimuth` in hundredths of a degree, and 32 `echoes` with `range` and `reflectivity`.
        """
        return self.payload.view(_PACKET)[:, 0]

    def select(self, rows: Bools) -> "VelodynePackets":
        """The packets where the mask is true."""
        return VelodynePackets(self.frame_id, self.stamps_ns[rows], self.payload[rows])


def parse_velodyne_scan(message: RawMessage) -> VelodynePackets:
    """The packets of a message; bytes after the last one are ignored."""
    cursor = cursor_of(message, SCAN)
    typestore_for(message.channel)  # the definition is the usual one
    layout = np.dtype([("stamp", f"{cursor.order}u4", 2), ("payload", "u1", PACKET_BYTES)])
    with damage_told(message):
        frame_id = cursor.frame_id()
        packets = cursor.records(layout, cursor.uint32())
    stamps = packets["stamp"].astype(np.int64)
    return VelodynePackets(clean_frame(frame_id), stamps[:, 0] * 10**9 + stamps[:, 1], packets["payload"])


# --- single packets, and the scans that runs of them make: neither direction decodes


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
    """Stamp and payload of a VelodynePacket, which has `PACKET_FIELDS`, little endian."""
    data, cursor = message.data, cursor_of(message, PACKET)
    start, end = cursor.at, cursor.at + _STAMPED_BYTES
    if len(data) < end:
        raise MessageError(f"{message.topic}: expected a {PACKET} of {end} bytes, found {len(data)} bytes")
    if cursor.order == ">":
        return struct.pack("<II", *struct.unpack_from(">II", data, start)) + data[start + 8 : end]
    return data[start:end]


def scan_data(packets: Sequence[bytes | memoryview]) -> bytes:
    """A VelodyneScan of `scan_channel` from `packet_data`, one or more: the first packet's stamp, and no frame."""
    head = _CDR_LITTLE_ENDIAN + packets[0][:8] + struct.pack("<I4xI", 1, len(packets))  # an empty name ends in a zero
    return head + b"\0\0".join(packets)
