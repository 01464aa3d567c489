"""The class of each cluster, and its box completed by the size prior of that class.

A lidar sees only the near sides of an object. A side that faces a lidar shows its whole length; the extent behind it is
taken from the size prior of the class. So a cluster is compared with each class, with the length along either axis of
the rectangle; missing length counts only as far as it should have been visible. The box then keeps its near sides and
grows away from the lidars; a cyclist's grows about its middle, and a pedestrian's half as far away as that of a car. Of
thin wheels and limbs hardly anything is seen, so neither is taken for smaller than its class.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.settings.classes import ClassPrior
from pipeline.detectors.cluster.lshape import Rectangles

__all__ = ["CompletedBoxes", "complete_boxes"]


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


def complete_boxes(
    rectangles: Rectangles,
    top_m: F64,
    lidar_share: F64,
    lidar_xy: F64,
    priors: tuple[ClassPrior, ...],
    given_ids: I64 | None = None,
) -> CompletedBoxes:
    """Choose the class of each cluster, where it is not given, and complete its box.

    Args:
        rectangles: Measured extents of C clusters.
        top_m: (C,) height of each cluster above the ground, metres.
        lidar_share: (C, L) share of each cluster's points measured by each lidar.
        lidar_xy: (L, 2) positions of the lidars, metres, in the frame of the clusters.
        priors: Sizes of the classes.
        given_ids: (C,) class of each cluster, whatever its size; -1 where it is to be chosen. None: all of them.
    """
    axes, extent = rectangles.axes, rectangles.high - rectangles.low  # (C, axis, xy), (C, axis)
    middle = (rectangles.high + rectangles.low) / 2
    towards = np.einsum("cax,lx->cla", axes, lidar_xy) - middle[:, None]  # (C, L, axis)
    distance = np.maximum(np.linalg.norm(towards, axis=2, keepdims=True), 1e-9)
    # The extent along one axis is visible on the side whose normal is the other axis.
    seen = np.einsum("cl,cla->ca", lidar_share, np.abs(towards / distance))[:, ::-1]

    kind_class, size, size_max = _kinds(priors)
    turned = [[0, 1, 2], [1, 0, 2]]  # length along the first axis, or along the second
    mean, limit = size[:, turned].reshape(-1, 3), size_max[:, turned].reshape(-1, 3)  # (2K, 3), of K kinds
    measured = np.concatenate([extent, top_m[:, None]], 1)[:, None]  # (C, 1, 3)
    visible = np.concatenate([seen, np.ones((len(seen), 1))], 1)[:, None]
    long = np.maximum(measured - mean, 0) / np.maximum((limit - mean) / 2, 1e-9)
    short = np.minimum(visible * np.maximum(mean - measured, 0) / (SHORT_SHARE * mean), SHORT_LIMIT)
    misfit = ((long**2 + short**2) / 2).sum(2)  # (C, 2K)
    rarity = -np.log(np.repeat(np.array([p.frequency for p in priors])[kind_class], 2))
    cost = np.where((measured <= limit).all(2), misfit + rarity, np.inf)
    if given_ids is not None:
        is_given = np.repeat(kind_class, 2) == given_ids[:, None]
        cost = np.where(is_given, misfit, np.where(given_ids[:, None] < 0, cost, np.inf))
    choice = cost.argmin(1)
    rows = np.arange(len(choice))
    class_ids = np.where(np.isfinite(cost[rows, choice]), kind_class[choice // 2], -1)

    chosen, chosen_limit = mean[choice], limit[choice]
    is_slender = chosen[:, :2].min(1) <= SLENDER_SHARE * chosen[:, 2]
    limits = chosen[:, :2], chosen_limit[:, :2]
    center, full, std = _grow(extent, middle, *limits, seen, towards, lidar_share, is_slender)
    is_round = chosen[:, :2].min(1) > ROUND_SHARE * chosen[:, :2].max(1)
    anchored = np.where(is_slender, np.where(is_round, ROUND_ANCHOR, 0.0), 1.0)[:, None]
    center = middle + anchored * (center - middle)
    rides = is_slender & ~is_round
    std = np.where(is_slender[:, None], (full - extent) / 4, std)
    height = np.where(top_m >= WHOLE_SHARE * chosen[:, 2], top_m, chosen[:, 2])
    swap = (choice % 2 == 1)[:, None]
    yaw = rectangles.angle_rad + np.where(swap[:, 0], np.pi / 2, 0.0)
    faces = (seen * full).sum(1) * height
    return CompletedBoxes(
        class_ids,
        np.einsum("ca,cax->cx", center, axes),
        np.concatenate([np.where(swap, full[:, ::-1], full), height[:, None]], 1),
        np.where(yaw > np.pi / 2, yaw - np.pi, yaw),
        misfit[rows, choice],
        np.where(swap, std[:, ::-1], std),
        faces,
        is_slender,
        rides,
    )


def _kinds(priors: tuple[ClassPrior, ...]) -> tuple[I64, F64, F64]:
    """The class (K,), the typical and the largest size (K, 3) of every kind of the classes."""
    class_ids, sizes, largest = [], [], []
    for class_id, prior in enumerate(priors):
        growth = np.array(prior.max_size_m) / prior.size_m
        for size_m in (prior.size_m, *prior.kinds_m):
            class_ids.append(class_id)
            sizes.append(size_m)
            largest.append(np.minimum(size_m * growth, prior.max_size_m))
    return np.array(class_ids), np.array(sizes), np.array(largest)


def _grow(
    extent: F64,
    middle: F64,
    prior: F64,
    limit: F64,
    seen: F64,
    towards: F64,
    lidar_share: F64,
    is_slender: Bools,
) -> tuple[F64, F64, F64]:
    """Centre, extent and standard deviation of the centre along each axis (C, 2), grown away from the lidars."""
    # -1: the lidar is beyond the low end, 1: beyond the high end, between: beside the object.
    end = np.clip(towards / (np.maximum(extent, prior / 2) / 2)[:, None], -1, 1)
    both = np.minimum(np.einsum("cl,cla->ca", lidar_share, end > 0.5), np.einsum("cl,cla->ca", lidar_share, end < -0.5))
    whole = (both >= BOTH_ENDS_SHARE) & (extent >= BOTH_ENDS_WHOLE_SHARE * prior)
    whole |= (seen > 0.5) & (extent >= WHOLE_SHARE * prior)
    whole &= ~is_slender[:, None]
    missing = np.where(whole, 0.0, np.maximum(prior - extent, 0))
    anchor = np.einsum("cl,cla->ca", lidar_share, end)
    full = extent + missing
    # A grown side errs by the spread of the class; half of that moves the centre.
    std = np.where(missing > 0, np.minimum((limit - prior) / 4, missing), 0.0)
    return middle - anchor * missing / 2, full, std
