"""velodyne_msgs/VelodyneScan as bytes: header, then packets of a stamp and 1206 bytes each, viewed where they lie.

The generic decoder takes 70 times as long: it makes an object of each packet. In CDR every stamp begins at a multiple
of four bytes, so packets lie 1216 bytes apart, yet nothing fills up the last one; in ROS 1 they lie 1214 apart.
"""

import struct
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import I64, U8, Array, Bools, check_array
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.readers.messages.cursor import Cursor
from lidcam.readers.messages.deserialize import typestore_for
from lidcam.readers.messages.tf import clean_frame

SCAN = "velodyne_msgs/msg/VelodyneScan"

SLOTS = 32
"""Ranges per block."""

_ECHO = np.dtype([("range", "<u2"), ("reflectivity", "u1")])
_BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("echoes", _ECHO, SLOTS)])
_PACKET = np.dtype([("blocks", _BLOCK, 12), ("clock_us", "<u4"), ("mode", "u1"), ("product", "u1")])
PACKET_BYTES = _PACKET.itemsize


_STAMP_BYTES = 8


@dataclass(frozen=True, slots=True, eq=False)
class VelodynePackets:
    """The packets of one scan in recorded order.

    Attributes:
        frame_id: Frame that the scan names.
        stamps_ns: (P,) int64, the driver's time of each packet, of measurement or of arrival.
        payload: (P, 1206) uint8, the bytes from the sensor; a view whose packets need not follow each other.
    """

    frame_id: str
    stamps_ns: I64
    payload: U8

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        check_array("stamps_ns", self.stamps_ns, (n,), np.int64)
        check_array("payload", self.payload, (n, PACKET_BYTES), np.uint8)

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
    """The packets of a message; bytes after the last one are ignored.

    Raises:
        MessageError: not a VelodyneScan, its recorded definition is not the usual one, or its bytes end too soon.
    """
    channel, data = message.channel, message.data
    if message.problem:
        raise MessageError(f"{channel.topic}: {message.problem}")
    if channel.msgtype != SCAN:
        raise MessageError(f"{channel.topic}: expected {SCAN}, found {channel.msgtype}")
    typestore_for(channel)  # the definition is the usual one
    try:
        frame_id, count, start, order, stride = _layout(channel, data)
    except (struct.error, UnicodeDecodeError) as err:
        raise MessageError(
            f"{channel.topic}: {len(data)} bytes are not a valid {SCAN}: its header is cut off or damaged"
        ) from err
    size = _STAMP_BYTES + PACKET_BYTES
    needed = start + (count - 1) * stride + size if count else start
    if needed > len(data):
        whole = max(len(data) - start - size + stride, 0) // stride
        raise MessageError(
            f"{channel.topic}: expected {count} packets in {needed} bytes, found {len(data)} bytes: "
            f"the message ends after {whole} whole packets"
        )
    if not count:
        return VelodynePackets(clean_frame(frame_id), np.zeros(0, np.int64), np.zeros((0, PACKET_BYTES), np.uint8))
    buffer = np.frombuffer(data, np.uint8)
    stamps = np.ndarray((count, 2), f"{order}u4", buffer, start, (stride, 4)).astype(np.int64)
    payload = np.ndarray((count, PACKET_BYTES), np.uint8, buffer, start + _STAMP_BYTES, (stride, 1))
    return VelodynePackets(clean_frame(frame_id), stamps[:, 0] * 10**9 + stamps[:, 1], payload)


def _layout(channel: Channel, data: bytes | memoryview) -> tuple[str, int, int, str, int]:
    """Frame, number of packets, position of the first, byte order, and distance from one to the next."""
    is_ros1, size = channel.encoding == "ros1", _STAMP_BYTES + PACKET_BYTES
    cursor = Cursor(data, channel.encoding)
    cursor.skip(4, 3 if is_ros1 else 2)  # the header's stamp, in ROS 1 behind its seq
    frame_id, count = cursor.string(), cursor.uint32()
    return frame_id, count, cursor.at, cursor.order, size if is_ros1 else (size + 3) // 4 * 4
