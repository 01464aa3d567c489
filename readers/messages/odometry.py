"""Decodes nav_msgs/Odometry."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, check_array
from pipeline.core.errors import FrameError, MessageError
from pipeline.core.geometry.transform import Transform
from pipeline.core.messages import RawMessage
from readers.messages.deserialize import deserialize_as
from readers.messages.tf import clean_frame

__all__ = ["ODOMETRY", "OdometrySample", "decode_odometry"]

ODOMETRY = "nav_msgs/msg/Odometry"


@dataclass(frozen=True, slots=True, eq=False)
class OdometrySample:
    """Pose and velocity of a moving frame at one time.

    Attributes:
        stamp_ns: Time of the estimate.
        frame_id: The frame it moves in (`odom`, `map`).
        child_frame_id: The frame that moves (`base_link`); empty if the publisher does not name it.
        T_parent_child: Pose of the child frame: `frame_id` from `child_frame_id`.
        linear_velocity: (3,) float64, metres a second, along the axes of the child frame.
        angular_velocity: (3,) float64, radians a second, about the axes of the child frame.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    T_parent_child: Transform
    linear_velocity: F64
    angular_velocity: F64

    def __post_init__(self) -> None:
        check_array("linear_velocity", self.linear_velocity, (3,), np.float64)
        check_array("angular_velocity", self.angular_velocity, (3,), np.float64)


def decode_odometry(message: RawMessage) -> OdometrySample:
    """The pose and twist of a nav_msgs/Odometry; covariances are ignored.

    Velocities are as recorded; NaN means unknown.

    Raises:
        MessageError: not an Odometry, the frames are missing or equal, or the pose is invalid.
    """
    odometry = deserialize_as(message, ODOMETRY)
    parent, child = clean_frame(odometry.header.frame_id), clean_frame(odometry.child_frame_id)
    if not parent or parent == child:
        raise MessageError(f"{message.topic}: expected two frame names, found frame_id {parent!r}, child {child!r}")
    position, orientation = odometry.pose.pose.position, odometry.pose.pose.orientation
    twist = odometry.twist.twist
    try:
        pose = Transform.from_quaternion(
            parent,
            child,
            [position.x, position.y, position.z],
            [orientation.x, orientation.y, orientation.z, orientation.w],
        )
    except FrameError as err:
        raise MessageError(f"{message.topic}: {err}") from err
    return OdometrySample(
        message.stamp_ns,
        parent,
        child,
        pose,
        np.array([twist.linear.x, twist.linear.y, twist.linear.z], np.float64),
        np.array([twist.angular.x, twist.angular.y, twist.angular.z], np.float64),
    )
