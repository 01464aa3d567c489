"""The numbers that stand for names in vision_msgs of ROS 1, and the hypotheses that are counts.

Truth of the simulator says in further hypotheses, whose score is a count, how much of an object its sensors see. ROS 2
names them; `lidar_points/NAME` and `image_pixels/NAME` are those of one sensor. ROS 1 numbers them with negative ids,
the sensors in the order of the scenario.
"""

from functools import lru_cache

CLASS_NUMBERS = {"car": 1, "pedestrian": 2, "cyclist": 3, "van": 4, "truck": 5, "bus": 6}
"""The first three as in the predecessor system."""

CLASS_OF_NUMBER = {str(number): name for name, number in CLASS_NUMBERS.items()}

LIDAR_POINTS = "lidar_points"
IMAGE_PIXELS = "image_pixels"

COUNT_NUMBERS = {LIDAR_POINTS: -1, IMAGE_PIXELS: -2, "instance": -3, "occlusion": -4, "truncation": -5}
"""`instance` is the row of the object in the scenario; occlusion and truncation are shares of it."""

OF_LIDAR, OF_CAMERA = -1000, -2000
"""The k-th lidar has the number -1000 - k, the k-th camera -2000 - k, k from 0."""

MAX_DIGITS = 18
"""Digits of a label that may be a number; Python reads no more than some thousand."""

_NAMES = {number: name for name, number in COUNT_NUMBERS.items()}


@lru_cache(maxsize=4096)
def count_of(label: str) -> str | None:
    """The name of the count of a hypothesis, by its class as text; None if the hypothesis is a class.

    Sensors that are only numbered are named by their number: `lidar_points/0`. A negative number without a meaning
    counts something, too: it is returned as it is.
    """
    if not label.startswith("-"):
        return label if label in COUNT_NUMBERS or label.startswith((f"{LIDAR_POINTS}/", f"{IMAGE_PIXELS}/")) else None
    if not label[1:].isdecimal() or len(label) > MAX_DIGITS:
        return None
    number = int(label)
    if number in _NAMES:
        return _NAMES[number]
    if OF_CAMERA < number <= OF_LIDAR:
        return f"{LIDAR_POINTS}/{OF_LIDAR - number}"
    if 2 * OF_CAMERA < number <= OF_CAMERA:
        return f"{IMAGE_PIXELS}/{OF_CAMERA - number}"
    return label
