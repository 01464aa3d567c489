"""What a vision_msgs detection says of an object: its class, and counts and shares, each a hypothesis with a score.

ROS 2 names them (`car`, `lidar_points/top`), ROS 1 numbers them; all that are not classes have negative numbers.
"""

from typing import NamedTuple

__all__ = [
    "CLASS_NUMBERS",
    "Hypothesis",
    "class_of",
    "image_pixels",
    "instance",
    "lidar_points",
    "occlusion",
    "truncation",
]

CLASS_NUMBERS = {"car": 1, "pedestrian": 2, "cyclist": 3, "van": 4, "truck": 5, "bus": 6}
"""ROS 1: the first three as in the predecessor system."""

LIDAR_POINTS, IMAGE_PIXELS, INSTANCE, OCCLUSION, TRUNCATION = -1, -2, -3, -4, -5
FIRST_LIDAR, FIRST_CAMERA = -1000, -2000
"""Numbers of the counts of the first sensor; those of the next ones follow downwards."""


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
        return Hypothesis(f"lidar_points/{sensor}", FIRST_LIDAR - row, float(count))
    return Hypothesis("lidar_points", LIDAR_POINTS, float(count))


def image_pixels(count: int, sensor: str = "", row: int = 0) -> Hypothesis:
    """The number of pixels that show an object: of one camera, as for `lidar_points`, or of all."""
    if sensor:
        return Hypothesis(f"image_pixels/{sensor}", FIRST_CAMERA - row, float(count))
    return Hypothesis("image_pixels", IMAGE_PIXELS, float(count))


def instance(row: int) -> Hypothesis:
    """Which object it is, for ROS 1, whose detections have no `id`: its row in the ground truth, -1 for none."""
    return Hypothesis("instance", INSTANCE, float(row))


def occlusion(share: float) -> Hypothesis:
    """The share of an object's pixels that others hide."""
    return Hypothesis("occlusion", OCCLUSION, share)


def truncation(share: float) -> Hypothesis:
    """The share of an object's whole box outside the image."""
    return Hypothesis("truncation", TRUNCATION, share)
