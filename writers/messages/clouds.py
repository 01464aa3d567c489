"""Clouds as sensor_msgs/PointCloud2."""

from typing import Any

import numpy as np

from pipeline.core.clouds import PointCloud
from pipeline.core.ros.messages import ROS2

__all__ = ["point_cloud2"]


def point_cloud2(cloud: PointCloud, *, stamp_ns: int, frame_id: str) -> Any:
    """x, y, z in metres, intensity, ring, and `time` in seconds after `stamp_ns`, laid out as by Velodyne's driver."""
    time_s = (cloud.time_offset_ns + float(cloud.stamp_ns - stamp_ns)) * 1e-9
    columns = {
        **dict(zip("xyz", cloud.xyz.T, strict=True)),
        "intensity": cloud.intensity,
        "ring": cloud.ring,
        "time": time_s.astype(np.float32),
    }
    return ROS2.cloud(stamp_ns, frame_id, columns)
