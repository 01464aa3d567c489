"""The class of each cluster, and its box completed by the size prior of that class.

A lidar sees only the near sides of an object. A side that faces a lidar shows its whole length; the extent behind it is
taken from the size prior of the class. So a cluster is compared with each class, with the length along either axis of
the rectangle; missing length counts only as far as it should have been visible. The box then keeps its near sides and
grows away from the lidars; a cyclist's grows about its middle, and a pedestrian's half as far away as that of a car. Of
thin wheels and limbs hardly anything is seen, so neither is taken for smaller than its class.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, Indices
from pipeline.core.settings.classes import ClassPrior
from pipeline.detectors.cluster.lshape import Rectangles

__all__ = ["CompletedBoxes", "Kinds", "complete_boxes"]

SHORT_SHARE = 0.2
"""Standard deviation of a measured extent below the prior, as a share of the prior; a side may be partly hidden."""

SHORT_LIMIT = 3.0
"""Missing length counts at most this many standard deviations: another object may stand in front."""

WHOLE_SHARE = 0.8
"""A side that faces a lidar is complete from this share of the prior on."""

BOTH_ENDS_SHARE = 0.1
"""Share of the points that lidars beyond each of two ends must have measured for both to count as seen."""

BOTH_ENDS_WHOLE_SHARE = 0.5
"""An extent with both ends seen is complete from this share of the prior on."""

SLENDER_SHARE = 0.5
"""A class whose width is at most this share of its height has no broad side that hides its far end: of a cyclist the
lidar sees the rider, in the middle. Such boxes grow to both ends alike."""

ROUND_SHARE = 0.5
"""A slender class whose width is more than this share of its length is a pedestrian's: the body hides its far side."""

ROUND_ANCHOR = 0.5
"""How far a pedestrian's box grows away from the lidar: 1 is as a car's, of which only the near sides are seen, and 0
about its middle. In simulated recordings of a crossing and of a drive, 1 put walkers 0.04 and 0.07 m too far away, 0
put them 0.09 and 0.02 m too near."""


@dataclass(frozen=True, eq=False)
class CompletedBoxes:
    """Boxes of C clusters, above flat ground.

    Attributes:
        class_ids: (C,) int64, row of the priors; -1 if the cluster is larger than every class.
        center_xy: (C, 2) float64, metres.
        sizes: (C, 3) float64 length, width, height, metres; the box stands on the ground.
        yaw_rad: (C,) float64 direction of the length, in (-pi/2, pi/2]: the front is not known.
        misfit: (C,) float64 squared deviation from the size prior in standard deviations, halved.
        center_std_m: (C, 2) float64 standard deviation of the centre along length and width.
        faces_m2: (C,) float64 area of the box visible to the lidars, from their mean direction.
        is_slender: (C,) bool, the class is that of a pedestrian or a rider, by its proportions.
        rides: (C,) bool, it is that of a rider.
    """

    class_ids: I64
    center_xy: F64
    sizes: F64
    yaw_rad: F64
    misfit: F64
    center_std_m: F64
    faces_m2: F64
    is_slender: Bools
    rides: Bools


@dataclass(frozen=True, eq=False)
class Kinds:
    """What clusters are compared with: K kinds of the classes, twice each, with the length along either axis.

    Attributes:
        class_ids: (2K,) int64, row of the priors.
        mean_m: (2K, 3) float64 typical extent along the first and the second axis, and height.
        limit_m: (2K, 3) float64 largest ones.
        rarity: (2K,) float64 negative logarithm of the frequency of the class.
    """

    class_ids: I64
    mean_m: F64
    limit_m: F64
    rarity: F64

    @classmethod
    def of(cls, priors: Sequence[ClassPrior]) -> "Kinds":
        """Those of all classes."""
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
    lidar_share: F64,
    lidar_xy: F64,
    kinds: Kinds,
    given_ids: I64 | None = None,
) -> CompletedBoxes:
    """Choose the class of each cluster, where it is not given, and complete its box.

    Args:
        rectangles: Measured extents of C clusters.
        top_m: (C,) height of each cluster above the ground, metres.
        lidar_share: (C, L) share of each cluster's points measured by each lidar.
        lidar_xy: (L, 2) positions of the lidars, metres, in the frame of the clusters.
        kinds: Sizes of the classes.
        given_ids: (C,) class of each cluster, whatever its size; -1 where it is to be chosen. None: all of them.
    """
    axes, extent = rectangles.axes, rectangles.high - rectangles.low  # (C, axis, xy), (C, axis)
    middle = (rectangles.high + rectangles.low) / 2
    towards = np.einsum("cax,lx->cla", axes, lidar_xy) - middle[:, None]  # (C, L, axis)
    distance_m = np.maximum(np.sqrt((towards * towards).sum(2, keepdims=True)), 1e-9)
    # The extent along one axis is visible on the side whose normal is the other axis.
    seen = np.einsum("cl,cla->ca", lidar_share, np.abs(towards / distance_m))[:, ::-1]
    class_ids, choice, misfit = _chosen(extent, top_m, seen, kinds, given_ids)

    mean, limit = kinds.mean_m[choice], kinds.limit_m[choice]
    narrow, wide = mean[:, :2].min(1), mean[:, :2].max(1)
    is_slender, is_round = narrow <= SLENDER_SHARE * mean[:, 2], narrow > ROUND_SHARE * wide
    # -1: the lidar is beyond the low end, 1: beyond the high end, between: beside the object.
    reach_m = np.maximum(extent, mean[:, :2] / 2) / 2
    end = np.clip(towards / reach_m[:, None], -1, 1)
    beyond, before = (np.einsum("cl,cla->ca", lidar_share, is_there) for is_there in (end > 0.5, end < -0.5))
    is_whole = (np.minimum(beyond, before) >= BOTH_ENDS_SHARE) & (extent >= BOTH_ENDS_WHOLE_SHARE * mean[:, :2])
    is_whole |= (seen > 0.5) & (extent >= WHOLE_SHARE * mean[:, :2])
    missing_m = np.where(is_whole & ~is_slender[:, None], 0.0, np.maximum(mean[:, :2] - extent, 0))
    grown = middle - np.einsum("cl,cla->ca", lidar_share, end) * missing_m / 2
    anchored = np.where(is_slender, np.where(is_round, ROUND_ANCHOR, 0.0), 1.0)[:, None]
    center = middle + anchored * (grown - middle)
    full = extent + missing_m
    # A grown side errs by the spread of the class; half of that moves the centre.
    std_m = np.where(missing_m > 0, np.minimum((limit - mean)[:, :2] / 4, missing_m), 0.0)
    std_m = np.where(is_slender[:, None], (full - extent) / 4, std_m)
    height = np.where(top_m >= WHOLE_SHARE * mean[:, 2], top_m, mean[:, 2])
    is_turned = choice % 2 == 1  # the length lies along the second axis
    yaw = rectangles.angle_rad + np.where(is_turned, np.pi / 2, 0.0)
    return CompletedBoxes(
        class_ids,
        np.einsum("ca,cax->cx", center, axes),
        np.column_stack([np.where(is_turned[:, None], full[:, ::-1], full), height]),
        np.where(yaw > np.pi / 2, yaw - np.pi, yaw),
        misfit,
        np.where(is_turned[:, None], std_m[:, ::-1], std_m),
        (seen * full).sum(1) * height,
        is_slender,
        is_slender & ~is_round,
    )


def _chosen(extent: F64, top_m: F64, seen: F64, kinds: Kinds, given_ids: I64 | None) -> tuple[I64, Indices, F64]:
    """The class of each cluster (C,), -1 if it is larger than every class; its kind (C,); and its misfit (C,)."""
    misfit, fits = np.zeros((len(top_m), len(kinds.rarity))), np.ones((len(top_m), len(kinds.rarity)), np.bool_)
    measured, visible = (extent[:, 0], extent[:, 1], top_m), (seen[:, 0], seen[:, 1], np.ones(len(top_m)))
    for axis in range(3):
        mean, limit = kinds.mean_m[:, axis], kinds.limit_m[:, axis]
        off = measured[axis][:, None] - mean  # (C, 2K)
        long = np.maximum(off, 0) / np.maximum((limit - mean) / 2, 1e-9)
        short = np.minimum(visible[axis][:, None] * np.maximum(-off, 0) / (SHORT_SHARE * mean), SHORT_LIMIT)
        misfit += (long**2 + short**2) / 2
        fits &= measured[axis][:, None] <= limit
    cost = np.where(fits, misfit + kinds.rarity, np.inf)
    if given_ids is not None:
        given = given_ids[:, None]
        cost = np.where(given < 0, cost, np.where(kinds.class_ids == given, misfit, np.inf))
    choice = cost.argmin(1)
    rows = np.arange(len(choice))
    return np.where(np.isfinite(cost[rows, choice]), kinds.class_ids[choice], -1), choice, misfit[rows, choice]
