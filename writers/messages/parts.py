"""Parts that many messages have."""

from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np

from pipeline.core.arrays import F64, Array
from pipeline.core.detections import Boxes3D
from pipeline.core.ros.messages import ROS2

__all__ = ["box_poses", "colors", "places_as_poses", "points", "split", "vectors"]


def points(numbers: F64) -> list[Any]:
    """geometry_msgs/Point of each row (N, 3)."""
    return ROS2.rows_of_numbers("geometry_msgs/msg/Point", numbers)


def vectors(numbers: F64) -> list[Any]:
    """geometry_msgs/Vector3 of each row (N, 3)."""
    return ROS2.rows_of_numbers("geometry_msgs/msg/Vector3", numbers)


def colors(rgba: F64, msgtype: str = "foxglove_msgs/msg/Color") -> list[Any]:
    """Colours of rows (N, 4): red, green, blue and opacity in [0, 1]."""
    return ROS2.rows_of_numbers(msgtype, rgba)


def box_poses(boxes: Boxes3D) -> list[Any]:
    """geometry_msgs/Pose of each box: its centre and heading."""
    turns = np.zeros((len(boxes), 4))
    turns[:, 2], turns[:, 3] = np.sin(boxes.yaws / 2), np.cos(boxes.yaws / 2)
    orientations = ROS2.rows_of_numbers("geometry_msgs/msg/Quaternion", turns)
    return ROS2.rows("geometry_msgs/msg/Pose", len(boxes), position=points(boxes.centers), orientation=orientations)


def places_as_poses(places: F64) -> list[Any]:
    """geometry_msgs/Pose of places (N, 3) without rotation."""
    no_turn = ROS2.new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    return ROS2.rows("geometry_msgs/msg/Pose", len(places), position=points(places), orientation=no_turn)


def split(items: Sequence[Any], counts: Array | Iterable[int]) -> list[list[Any]]:
    """The items in lists of so many."""
    left = iter(items)
    return [list(islice(left, count)) for count in (counts.tolist() if isinstance(counts, np.ndarray) else counts)]
