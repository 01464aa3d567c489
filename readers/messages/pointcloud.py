"""Clouds of tens of thousands of points that are read in place, not as objects of their own.

sensor_msgs/PointCloud, which PointCloud2 replaced, has points, and channels of one number for each. The CustomMsg of
Livox's drivers has points with a time each, as FAST-LIO and other odometries take them; three packages have the same
message: livox_ros_driver and livox_ros_driver2 (ROS 1, ROS 2), livox_interfaces (ROS 2).
"""

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import Cursor, cursor_of, damage_told, typestore_for
from lidcam.readers.messages.pointcloud2 import MAX_OFFSET_NS, check_points, cloud_of_columns, cloud_of_fields
from lidcam.readers.messages.tf import clean_frame

POINT_CLOUD = "sensor_msgs/msg/PointCloud"

MAX_CHANNELS = 64


@decoder
def decode_pointcloud(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0, calibrated: bool = True
) -> PointCloud:
    """The points of a message; channels have the meaning of PointCloud2's fields of their names."""
    return cloud_of_fields(message, read_pointcloud(message, limits=limits, others=others), calibrated=calibrated)


@decoder
def read_pointcloud(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Any:
    """The same as a sensor_msgs/PointCloud2; channels of another length than the points are left out."""
    channel, data, cursor = message.channel, message.data, cursor_of(message, POINT_CLOUD)
    typestore_for(channel)  # the definition is the usual one
    with damage_told(message):
        frame_id, count = cursor.frame_id(), cursor.uint32()
        check_points(count, channel.topic, limits, others)
        xyz = _numbers(data, cursor, 3 * count).reshape(-1, 3)
        columns: dict[str, Array] = dict(zip("xyz", xyz.T, strict=True))
        for _ in range(min(cursor.uint32(), MAX_CHANNELS)):
            name = cursor.string()
            values = _numbers(data, cursor, cursor.uint32())
            if len(values) == count:
                columns.setdefault(name, values)
    return ROS2.cloud(message.stamp_ns, frame_id, columns)


def _numbers(data: bytes | memoryview, cursor: Cursor, count: int) -> Array:
    """(count,) the next numbers; raises ValueError where the data end before."""
    cursor.skip(4, count)
    return np.frombuffer(data, f"{cursor.order}f4", count, cursor.at - 4 * count).astype(np.float32)


PACKAGES = ("livox_interfaces", "livox_ros_driver", "livox_ros_driver2")
CUSTOM = frozenset(f"{package}/msg/CustomMsg" for package in PACKAGES)

_NUMBERS = {"uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4", "float32": "f4"}
"""Types of the fields of a point: none is longer than the first one, to which points are aligned."""

_HEAD = ("header", "timebase", "point_num", "lidar_id", "rsvd", "points")


@dataclass(frozen=True, slots=True, eq=False)
class LivoxPoints:
    """The points of one message in recorded order."""

    frame_id: str  # Frame of the lidar
    timebase_ns: int  # Time of the first point by the lidar's clock
    points: Array  # (N,) records as the recording defines them, among others x, y, z in metres, offset_time in ns


def parse_livox(message: RawMessage) -> LivoxPoints:
    """The points of a CustomMsg, a view of its bytes."""
    cursor = cursor_of(message, *sorted(CUSTOM))
    layout = _point(message.channel, cursor.order)
    with damage_told(message):
        frame_id = cursor.frame_id()
        cursor.skip(8)
        (timebase_ns,) = struct.unpack_from(f"{cursor.order}Q", message.data, cursor.at - 8)
        cursor.skip(4)  # the number of points, which the length of their list repeats
        cursor.skip(1, 4)
        return LivoxPoints(clean_frame(frame_id), int(timebase_ns), cursor.records(layout, cursor.uint32()))


@decoder
def decode_livox(
    message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0, calibrated: bool = True
) -> PointCloud:
    """The points of a message, with reflectivity as intensity and line as ring; as `decode_pointcloud2` otherwise.

    Times are `timebase` and `offset_time`. Where the header has another clock than the lidar, it is taken to have the
    time of the first point.
    """
    found = parse_livox(message)
    points = found.points
    check_points(len(points), message.topic, limits, others)
    columns = {str(name): np.ascontiguousarray(points[name])[None] for name in points.dtype.names or ()}
    begin_ns = found.timebase_ns - message.stamp_ns
    columns["offset_time"] = columns["offset_time"].astype(np.int64) + begin_ns * (abs(begin_ns) <= MAX_OFFSET_NS)
    return cloud_of_columns(message, found.frame_id, columns, calibrated=calibrated)


@lru_cache(maxsize=256)
def _point(channel: Channel, order: str) -> Any:
    """The layout of a point; raises MessageError if the definition is none of Livox's."""
    types = typestore_for(channel).fielddefs
    if tuple(name for name, _ in types[channel.msgtype][1]) != _HEAD:
        raise MessageError(f"{channel.topic}: its definition of {channel.msgtype} has other fields than Livox's")
    names, formats, offsets, end = list[str](), list[str](), list[int](), 0
    for name, (node, detail) in types[f"{channel.msgtype.partition('/')[0]}/msg/CustomPoint"][1]:
        if node != Nodetype.BASE or detail[0] not in _NUMBERS:
            raise MessageError(f"{channel.topic}: its definition of a point has a field {name} that Livox's has not")
        dtype = np.dtype(order + _NUMBERS[detail[0]])
        end += -end % dtype.itemsize if channel.encoding == "cdr" else 0
        names.append(name)
        formats.append(dtype.str)
        offsets.append(end)
        end += dtype.itemsize
    if formats[:1] != [np.dtype(f"{order}u4").str] or not {"offset_time", "x", "y", "z"} <= {*names}:
        raise MessageError(f"{channel.topic}: its definition of a point lacks fields of Livox's")
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})
