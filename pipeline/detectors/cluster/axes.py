"""Axes of vehicles by those around them: vehicles drive and park along each other, or across.

The rectangle that fits a few points best may be turned by tens of degrees. In single frames of KITTI drive 0009, cars
whose heading is off by more than 8 degrees have surer ones around them, the axes of which are off by 1.5 degrees in the
median.
"""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.detections import Boxes3D

NEIGHBOUR_M = 30.0
"""Standard deviation of the distance at which neighbours count, metres. Of 10 to 40 about the best, as all values here,
in KITTI drive 0009 with 64, 32 and 16 beams, and in drawn crossings, roads, car parks and roundabouts."""

MIN_APART_M = 2.0
"""Minimum distance of neighbours, metres: nearer boxes are of the same vehicle."""

SURE_POINTS = 100.0
"""Number of points at which the axis of a neighbour has half of the full weight."""

ANY_WEIGHT = 1.0
"""Weight of the possibility that an axis has nothing to do with those of its neighbours, in neighbours."""

AXIS_SIGMA_RAD = np.deg2rad(4.0)
"""Standard deviation of the axes of vehicles about those of their neighbours, radians."""

_DENSITY = np.pi / 2 / (np.sqrt(2 * np.pi) * AXIS_SIGMA_RAD)  # at the mean, beside that of any axis


class Axes(NamedTuple):
    """Expected axes of the sides of N boxes."""

    angles_rad: F64  # (N,) about +z, modulo 90 degrees
    log_odds: F64  # (N,) logarithm of the odds of this axis against any other; -inf where nothing is known

    @classmethod
    def unknown(cls, count: int) -> "Axes":
        """Nothing is known."""
        return cls(np.zeros(count), np.full(count, -np.inf))


def axes_of_neighbours(boxes: Boxes3D, are_vehicles: Bools) -> Axes:
    """Mean axes of the vehicles around each vehicle; those of other boxes are unknown."""
    apart_m = np.linalg.norm(boxes.centers[:, None, :2] - boxes.centers[:, :2], axis=2)
    sure = are_vehicles * boxes.scores * boxes.point_counts / (boxes.point_counts + SURE_POINTS)
    weights = np.exp(-((apart_m / NEIGHBOUR_M) ** 2) / 2) * sure * (apart_m > MIN_APART_M)
    # Not a product of matrices: it adds up in another order with other numbers of threads.
    mean = (weights * np.exp(4j * boxes.yaws)).sum(1) / (weights.sum(1) + ANY_WEIGHT)
    share = np.abs(mean) * are_vehicles
    with np.errstate(divide="ignore"):
        return Axes(np.angle(mean) / 4, np.log(_DENSITY * share / (1 - share)))
