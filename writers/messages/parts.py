"""Parts that many messages have, as columns (`pipeline.core.ros.columns`)."""

import struct
from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D
from pipeline.core.ros.columns import Columns

__all__ = ["IDENTITY", "box_poses", "header", "headers", "places_as_poses", "time", "times"]

_TIME, _LENGTH = struct.Struct("<iI"), struct.Struct("<I")  # the latter of texts

IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""A geometry_msgs/Pose: position x, y, z, then quaternion x, y, z, w."""


def time(stamp_ns: int) -> bytes:
    """builtin_interfaces/Time, as it stands in any message."""
    return _TIME.pack(*divmod(stamp_ns, 10**9))


def times(stamps_ns: Sequence[int]) -> Columns:
    """builtin_interfaces/Time of each row."""
    stamps = np.array(stamps_ns, np.int64)
    return Columns("builtin_interfaces/msg/Time", len(stamps), sec=stamps // 10**9, nanosec=stamps % 10**9)


def header(stamp_ns: int, frame_id: str) -> bytes:
    """std_msgs/Header, as it stands in any message."""
    encoded = frame_id.encode() + b"\0"
    return time(stamp_ns) + _LENGTH.pack(len(encoded)) + encoded


def headers(stamps_ns: Sequence[int], frame_ids: Sequence[str]) -> Columns:
    """std_msgs/Header of each row."""
    return Columns("std_msgs/msg/Header", len(frame_ids), stamp=times(stamps_ns), frame_id=frame_ids)


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
