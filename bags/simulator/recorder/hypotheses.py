"""The hypotheses of a vision_msgs detection: an object's class, and counts and shares, each with a score.

ROS 2 names them (`car`, `lidar_points/top`), ROS 1 numbers them; all that are not classes have negative numbers.
"""

from typing import NamedTuple

from pipeline.core.ros.vision_numbers import (
    CLASS_NUMBERS,
    COUNT_NUMBERS,
    IMAGE_PIXELS,
    LIDAR_POINTS,
    OF_CAMERA,
    OF_LIDAR,
)

__all__ = [
    "Hypothesis",
    "class_of",
    "image_pixels",
    "instance",
    "lidar_points",
    "occlusion",
    "truncation",
]


class Hypothesis(NamedTuple):
    """One hypothesis.

    Attributes:
        name: `class_id` in ROS 2.
        number: `id` in ROS 1.
        score: Its score, or a count or share.
    """

    name: str
    number: int
    score: float


def class_of(name: str, score: float = 1.0) -> Hypothesis:
    """The class of an object, a key of `CLASS_NUMBERS`."""
    return Hypothesis(name, CLASS_NUMBERS[name], score)


def lidar_points(count: int, sensor: str = "", row: int = 0) -> Hypothesis:
    """The number of points on an object: of one lidar, given by its name and its row among the lidars, or of all."""
    if sensor:
        return Hypothesis(f"{LIDAR_POINTS}/{sensor}", OF_LIDAR - row, float(count))
    return _counted(LIDAR_POINTS, count)


def image_pixels(count: int, sensor: str = "", row: int = 0) -> Hypothesis:
    """The number of pixels that show an object: of one camera, as for `lidar_points`, or of all."""
    if sensor:
        return Hypothesis(f"{IMAGE_PIXELS}/{sensor}", OF_CAMERA - row, float(count))
    return _counted(IMAGE_PIXELS, count)


def instance(row: int) -> Hypothesis:
    """Which object it is, for ROS 1, whose detections have no `id`: its row in the ground truth, -1 for none."""
    return _counted("instance", row)


def occlusion(share: float) -> Hypothesis:
    """The share of an object's pixels that others hide."""
    return _counted("occlusion", share)


def truncation(share: float) -> Hypothesis:
    """The share of an object's whole box outside the image."""
    return _counted("truncation", share)


def _counted(name: str, score: float) -> Hypothesis:
    return Hypothesis(name, COUNT_NUMBERS[name], float(score))
