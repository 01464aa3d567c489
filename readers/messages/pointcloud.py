"""Decodes sensor_msgs/PointCloud, which PointCloud2 replaced: points, and channels of one number for each.

Points are read in place, not as objects of their own.
"""

import struct
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.cursor import Cursor
from lidcam.readers.messages.deserialize import typestore_for
from lidcam.readers.messages.pointcloud2 import check_points, cloud_of_fields

POINT_CLOUD = "sensor_msgs/msg/PointCloud"

MAX_CHANNELS = 64


@decoder
def decode_pointcloud(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> PointCloud:
    """The points of a message; channels have the meaning of PointCloud2's fields of their names.

    Raises:
        MessageError: as of `read_pointcloud` and `decode_pointcloud2`.
    """
    return cloud_of_fields(message, read_pointcloud(message, limits=limits, others=others))


@decoder
def read_pointcloud(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS, others: int = 0) -> Any:
    """The same as a sensor_msgs/PointCloud2; channels of another length than the points are left out.

    Raises:
        MessageError: not a PointCloud, its bytes end too soon, or there are more points than `limits` allow.
    """
    channel, data = message.channel, message.data
    if message.problem:
        raise MessageError(f"{channel.topic}: {message.problem}")
    if channel.msgtype != POINT_CLOUD:
        raise MessageError(f"{channel.topic}: expected {POINT_CLOUD}, found {channel.msgtype}")
    typestore_for(channel)  # the definition is the usual one
    cursor = Cursor(data, channel.encoding)
    try:
        cursor.skip(4, 3 if channel.encoding == "ros1" else 2)  # the header's stamp, in ROS 1 behind its seq
        frame_id, count = cursor.string(), cursor.uint32()
        check_points(count, channel.topic, limits, others)
        xyz = _numbers(data, cursor, 3 * count).reshape(-1, 3)
        columns: dict[str, Array] = dict(zip("xyz", xyz.T, strict=True))
        for _ in range(min(cursor.uint32(), MAX_CHANNELS)):
            name = cursor.string()
            values = _numbers(data, cursor, cursor.uint32())
            if len(values) == count:
                columns.setdefault(name, values)
    except (struct.error, UnicodeDecodeError, ValueError) as err:
        raise MessageError(f"{channel.topic}: {len(data)} bytes of a {POINT_CLOUD} that is cut off or damaged") from err
    return ROS2.cloud(message.stamp_ns, frame_id, columns)


def _numbers(data: bytes | memoryview, cursor: Cursor, count: int) -> Array:
    """(count,) the next numbers; raises ValueError where the data end before."""
    cursor.skip(4, count)
    return np.frombuffer(data, f"{cursor.order}f4", count, cursor.at - 4 * count).astype(np.float32)
