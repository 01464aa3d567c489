"""Objects of Autoware's DetectedObjects (autoware_perception_msgs, and its predecessor autoware_auto_perception_msgs).

An object's score is its `existence_probability`, its class that with the highest probability; classes are numbered.
Cylinders become boxes around them, polygons boxes around their footprint, along the axes of the object.
"""

from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.rotations import matrix_of_quaternion
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.boundary.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.objects.found import (
    AUTOWARE_LABELS,
    FoundObjects,
    ObjectClasses,
    check_boxes,
    found_objects,
)

DETECTED_OBJECTS = frozenset(
    {"autoware_perception_msgs/msg/DetectedObjects", "autoware_auto_perception_msgs/msg/DetectedObjects"}
)

UNAVAILABLE = 0
"""`orientation_availability` of an object whose heading is unknown."""

POLYGON = 2
"""`type` of a shape that is a footprint with a height."""

ANY_HEADING_RAD2 = np.pi**2 / 3
"""Variance of a heading of which nothing is known."""

_YAW = 35
"""Place of the variance of the rotation about z among the 36 of a pose."""


@decoder
def decode_detected_objects(
    message: RawMessage, classes: ObjectClasses, *, limits: RecordingLimits = DEFAULT_LIMITS
) -> FoundObjects:
    """The objects of a message.

    Raises:
        MessageError: not a DetectedObjects, or more objects than `limits` allow.
    """
    array = deserialize_as(message, *sorted(DETECTED_OBJECTS), limits=limits)
    count = check_boxes(array.objects, message.topic, limits)
    numbers, covariances, scores = np.zeros((count, 10)), np.zeros((count, 36)), np.zeros(count)
    for row, one in enumerate(array.objects):
        numbers[row] = _numbers(one)
        covariances[row] = _covariance(one.kinematics)
        scores[row] = one.existence_probability
    labels = [_label(one) for one in array.objects]
    return found_objects(message.stamp_ns, array.header.frame_id, numbers, covariances, scores, labels, classes)


def _label(one: Any) -> str | None:
    """The likeliest class, of equal ones the first; None without one."""
    best = max(one.classification, key=lambda known: float(known.probability), default=None)
    if best is None:
        return None
    return AUTOWARE_LABELS[best.label] if best.label < len(AUTOWARE_LABELS) else str(best.label)


def _numbers(one: Any) -> F64:
    """(10,) position, orientation and size of the box around an object."""
    pose, size = one.kinematics.pose_with_covariance.pose, one.shape.dimensions
    at = np.array([pose.position.x, pose.position.y, pose.position.z])
    turn = np.array([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
    if one.kinematics.orientation_availability == UNAVAILABLE and not turn.any():
        turn = np.array([0.0, 0.0, 0.0, 1.0])
    extent = np.array([size.x, size.y, size.z])
    corners = np.array([[corner.x, corner.y] for corner in one.shape.footprint.points], np.float64).reshape(-1, 2)
    is_whole = len(corners) and np.isfinite(corners).all() and np.isfinite(turn).all() and turn.any()
    if one.shape.type == POLYGON and is_whole:
        low, high = corners.min(0), corners.max(0)
        extent[:2] = high - low
        at = at + matrix_of_quaternion(turn) @ [*((low + high) / 2), 0.0]
    return np.concatenate([at, turn, extent])


def _covariance(kinematics: Any) -> F64:
    """(36,) of the pose; without that of the position where it is not given, and with an open heading where it is."""
    found = np.array(kinematics.pose_with_covariance.covariance, np.float64)
    if not kinematics.has_position_covariance:
        found[:] = 0.0
    if kinematics.orientation_availability == UNAVAILABLE:
        found.reshape(6, 6)[5, :] = found.reshape(6, 6)[:, 5] = 0.0
        found[_YAW] = ANY_HEADING_RAD2
    return found
