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

__all__ = ["Hypothesis", "class_of", "counted", "counted_by"]

FIRST_NUMBERS = {LIDAR_POINTS: OF_LIDAR, IMAGE_PIXELS: OF_CAMERA}


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


def counted(name: str, value: float) -> Hypothesis:
    """A count or share of an object, by its name in `COUNT_NUMBERS`."""
    return Hypothesis(name, COUNT_NUMBERS[name], float(value))


def counted_by(name: str, count: int, sensor: str, row: int) -> Hypothesis:
    """A count of one lidar or camera, given by its name and its row among them."""
    return Hypothesis(f"{name}/{sensor}", FIRST_NUMBERS[name] - row, float(count))
