"""The class of each cluster, and its box completed by the size prior of that class.

A lidar sees only the near sides of an object. A side that faces a lidar shows its whole length; the extent behind it is
taken from the size prior of the class. So a cluster is compared with each class, with the length along either axis of
the rectangle; missing length counts only as far as it should have been visible. The box then keeps its near sides and
grows away from the lidars; a cyclist's grows about its middle, and a pedestrian's a quarter as far away as that of a
car. Of thin wheels and limbs hardly anything is seen, so neither is taken for smaller than its class; nor for lower, as
far as the head may be between two beams.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.detectors.cluster.axes import Axes
from lidcam.pipeline.detectors.cluster.lshape import Rectangles
from lidcam.pipeline.native.kernels import completed_boxes

MAX_SLENDER_SHARE = 0.5
"""Maximum width of a slender class, as a share of its height: it has no broad side that hides its far end. Of a cyclist
the lidar sees the rider, in the middle. Such boxes grow to both ends alike."""


class Directions(NamedTuple):
    """Directions of C objects, as they are known before their boxes are fitted."""

    yaws: F64  # (C,) of their lengths, radians
    variances: F64  # (C,) rad^2
    axes: Axes  # Of their sides

    def of_rows(self, rows: Indices) -> "Directions":
        """Those of some objects."""
        return Directions(self.yaws[rows], self.variances[rows], Axes(*(column[rows] for column in self.axes)))


@dataclass(frozen=True, eq=False)
class CompletedBoxes:
    """Boxes of C clusters, above flat ground."""

    class_ids: I64  # (C,) int64, row of the priors; -1 if the cluster is larger than every class
    center_xy: F64  # (C, 2) float64, metres
    sizes: F64  # (C, 3) float64 length, width, height, metres; the box stands on the ground
    yaw_rad: F64  # (C,) float64 direction of the length, in (-pi/2, pi/2]: the front is not known
    misfit: F64  # (C,) float64 squared deviation from the size prior in standard deviations, halved
    center_std_m: F64  # (C, 2) float64 standard deviation of the centre along length and width
    faces_m2: F64  # (C,) float64 area that the lidars may see from their mean direction, up to the top that was seen
    rides: Bools  # (C,) bool, the class is that of a rider, by its proportions


@dataclass(frozen=True, eq=False)
class Kinds:
    """Sizes of the classes that clusters are compared with, each twice, with the length along either axis."""

    class_ids: I64  # (2K,) int64, row of the priors
    mean_m: F64  # (2K, 3) float64 typical extent along the first and the second axis, and height
    limit_m: F64  # (2K, 3) float64 largest ones
    rarity: F64  # (2K,) float64 negative logarithm of the frequency of the class

    @classmethod
    def of(cls, priors: Sequence[ClassPrior]) -> "Kinds":
        """Sizes of all classes."""
        class_ids, mean_m, limit_m = [], [], []
        for class_id, prior in enumerate(priors):
            growth = np.array(prior.max_size_m) / prior.size_m
            for size_m in (prior.size_m, *prior.kinds_m):
                class_ids += [class_id, class_id]
                largest_m = np.minimum(size_m * growth, prior.max_size_m)
                for turned in ([0, 1, 2], [1, 0, 2]):
                    mean_m.append(np.array(size_m)[turned])
                    limit_m.append(largest_m[turned])
        frequency = np.array([prior.frequency for prior in priors])
        return cls(np.array(class_ids), np.array(mean_m), np.array(limit_m), -np.log(frequency[class_ids]))


def complete_boxes(
    rectangles: Rectangles,
    top_m: F64,
    gap_m: F64,
    lidar_share: F64,
    lidar_xy: F64,
    kinds: Kinds,
    given_ids: I64 | None = None,
    directions: Directions | None = None,
) -> CompletedBoxes:
    """Choose the class of each cluster, where it is not given, and complete its box.

    Args:
        rectangles: Measured extents of C clusters.
        top_m: (C,) height of each cluster above the ground, metres.
        gap_m: (C,) how much higher the object may be, as beams are that far apart, metres.
        lidar_share: (C, L) share of each cluster's points measured by each lidar.
        lidar_xy: (L, 2) positions of the lidars, metres, in the frame of the clusters.
        kinds: Sizes of the classes.
        given_ids: (C,) class of each cluster, whatever its size; -1 where it is to be chosen. None: all of them.
        directions: If something tells them: which side is the length is decided with the sizes.
    """
    axis_costs = np.zeros((len(top_m), 2))
    if directions is not None:
        away_rad = directions.yaws[:, None] - rectangles.angle_rad[:, None] - [0.0, np.pi / 2]
        away_rad = wrap_angle(2 * away_rad) / 2  # front and rear do not count
        axis_costs = away_rad**2 / (2 * directions.variances[:, None])
    return CompletedBoxes(
        *completed_boxes(
            rectangles.low,
            rectangles.high,
            rectangles.angle_rad,
            np.cos(rectangles.angle_rad),
            np.sin(rectangles.angle_rad),
            top_m,
            gap_m,
            lidar_share,
            lidar_xy,
            kinds.class_ids,
            kinds.mean_m,
            kinds.limit_m,
            kinds.rarity,
            np.full(len(top_m), -1) if given_ids is None else np.ascontiguousarray(given_ids),
            axis_costs,
            MAX_SLENDER_SHARE,
        )
    )
