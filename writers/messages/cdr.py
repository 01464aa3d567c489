"""CDR of the messages that make up nearly all bytes: clouds, and images as they were recorded.

Numbers are little endian and aligned to their size, counted from the end of the four bytes of encapsulation (OMG CDR;
DDS-RTPS 10.2). Payloads are copied once.
"""

import struct
from typing import Self

import numpy as np

from pipeline.core.clouds import PointCloud

__all__ = ["CdrEncoder", "point_cloud2"]

# Fields as Velodyne's ROS drivers lay them out: name, offset, sensor_msgs/PointField datatype, numpy type.
_POINT_FIELDS = (
    ("x", 0, 7, "<f4"),
    ("y", 4, 7, "<f4"),
    ("z", 8, 7, "<f4"),
    ("intensity", 12, 7, "<f4"),
    ("ring", 16, 4, "<u2"),
    ("time", 18, 7, "<f4"),
)
_POINT_STEP = 22
_POINT = np.dtype(
    {
        "names": [name for name, _, _, _ in _POINT_FIELDS],
        "formats": [dtype for _, _, _, dtype in _POINT_FIELDS],
        "offsets": [offset for _, offset, _, _ in _POINT_FIELDS],
        "itemsize": _POINT_STEP,
    }
)


class CdrEncoder:
    """Builds the bytes of one message, field after field.

    Attributes:
        buffer: The message so far, encapsulation included.
    """

    def __init__(self) -> None:
        self.buffer = bytearray(b"\x00\x01\x00\x00")

    def u8(self, value: int) -> Self:
        """One byte: also a boolean."""
        self.buffer.append(value)
        return self

    def u32(self, *values: int) -> Self:
        """Numbers of four bytes: also lengths, and the seconds of a time while they are positive."""
        self.buffer += bytes(-len(self.buffer) % 4)
        self.buffer += struct.pack(f"<{len(values)}I", *values)
        return self

    def string(self, value: str | bytes) -> Self:
        """A string, with its closing zero byte."""
        encoded = value.encode() if isinstance(value, str) else value
        self.u32(len(encoded) + 1)
        self.buffer += encoded
        self.buffer.append(0)
        return self

    def header(self, stamp_ns: int, frame_id: str) -> Self:
        """std_msgs/Header."""
        return self.u32(*divmod(stamp_ns, 10**9)).string(frame_id)

    def byte_sequence(self, data: bytes | memoryview) -> Self:
        """A sequence of bytes."""
        self.u32(len(data))
        self.buffer += data
        return self


def point_cloud2(cloud: PointCloud, *, stamp_ns: int, frame_id: str) -> bytearray:
    """sensor_msgs/PointCloud2: x, y, z in metres, intensity, ring, and `time` in seconds after `stamp_ns`."""
    n = len(cloud)
    cdr = CdrEncoder().header(stamp_ns, frame_id).u32(1, n, len(_POINT_FIELDS))
    for name, offset, datatype, _ in _POINT_FIELDS:
        cdr.string(name).u32(offset).u8(datatype).u32(1)
    cdr.u8(0).u32(_POINT_STEP, _POINT_STEP * n, _POINT_STEP * n)
    start = len(cdr.buffer)
    cdr.buffer += bytes(_POINT_STEP * n + 1)  # the last byte is `is_dense`: PointCloud holds finite points only
    cdr.buffer[-1] = 1
    points = np.frombuffer(cdr.buffer, _POINT, n, start)
    for column, name in enumerate("xyz"):
        points[name] = cloud.xyz[:, column]
    points["intensity"] = cloud.intensity
    points["ring"] = cloud.ring
    points["time"] = (cloud.time_offset_ns + float(cloud.stamp_ns - stamp_ns)) * 1e-9
    return cdr.buffer
