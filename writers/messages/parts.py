"""Parts that many messages have, as columns (`pipeline.core.ros.columns`)."""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D
from pipeline.core.ros.columns import Columns

__all__ = ["IDENTITY", "box_poses", "headers", "places_as_poses", "times"]

IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""A geometry_msgs/Pose: position x, y, z, then quaternion x, y, z, w."""


def times(stamp_ns: int | Sequence[int]) -> Columns:
    """builtin_interfaces/Time: one for all rows, or one for each."""
    kind = "builtin_interfaces/msg/Time"
    if isinstance(stamp_ns, int):
        return Columns(kind, sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    stamps = np.array(stamp_ns, np.int64)
    return Columns(kind, len(stamps), sec=stamps // 10**9, nanosec=stamps % 10**9)


def headers(stamp_ns: int | Sequence[int], frame_id: str | Sequence[str]) -> Columns:
    """std_msgs/Header: one for all rows, or one for each."""
    stamps = times(stamp_ns)
    return Columns("std_msgs/msg/Header", stamps.count, stamp=stamps, frame_id=frame_id)


def box_poses(boxes: Boxes3D) -> F64:
    """(N, 7) geometry_msgs/Pose of each box: its centre and heading."""
    poses, half = np.zeros((len(boxes), 7)), boxes.yaws / 2
    poses[:, :3], poses[:, 5], poses[:, 6] = boxes.centers, np.sin(half), np.cos(half)
    return poses


def places_as_poses(places: F64) -> F64:
    """(N, 7) geometry_msgs/Pose of places (N, 3) without rotation."""
    poses = np.zeros((len(places), 7))
    poses[:, :3], poses[:, 6] = places, 1.0
    return poses
