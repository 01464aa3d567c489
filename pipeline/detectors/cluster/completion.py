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

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.compiled import compiled
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.detectors.cluster.lshape import Rectangles

SHORT_SHARE = 0.2
"""Standard deviation of a measured extent below the prior, as a share of the prior; a side may be partly hidden."""

MAX_SHORT_SIGMAS = 3.0
"""Maximum of missing length, in standard deviations: another object may stand in front."""

WHOLE_SHARE = 0.8
"""Minimum extent of a complete side that faces a lidar, as a share of the prior."""

BOTH_ENDS_SHARE = 0.1
"""Minimum share of the points that lidars beyond each of two ends measured, for both ends to count as seen."""

BOTH_ENDS_WHOLE_SHARE = 0.5
"""Minimum extent of a complete side with both ends seen, as a share of the prior."""

MAX_SLENDER_SHARE = 0.5
"""Maximum width of a slender class, as a share of its height: it has no broad side that hides its far end. Of a cyclist
the lidar sees the rider, in the middle. Such boxes grow to both ends alike."""

MAX_RIDER_SHARE = 0.5
"""Maximum width of a slender class that rides, as a share of its length: a pedestrian's body hides its far side."""

PEDESTRIAN_ANCHOR = 0.5
"""Growth of a pedestrian's box away from the lidar: 1 is as a car's, of which only the near sides are seen, 0 about its
middle."""

_LIST, _TABLE = "Array(float64, 1, 'C', readonly=True)", "Array(float64, 2, 'C', readonly=True)"


@dataclass(frozen=True, eq=False)
class CompletedBoxes:
    """Boxes of C clusters, above flat ground."""

    class_ids: I64  # (C,) int64, row of the priors; -1 if the cluster is larger than every class
    center_xy: F64  # (C, 2) float64, metres
    sizes: F64  # (C, 3) float64 length, width, height, metres; the box stands on the ground
    yaw_rad: F64  # (C,) float64 direction of the length, in (-pi/2, pi/2]: the front is not known
    misfit: F64  # (C,) float64 squared deviation from the size prior in standard deviations, halved
    center_std_m: F64  # (C, 2) float64 standard deviation of the centre along length and width
    faces_m2: F64  # (C,) float64 area of the box visible to the lidars, from their mean direction
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
    return CompletedBoxes(
        *_completed(
            rectangles.low,
            rectangles.high,
            rectangles.angle_rad,
            np.cos(rectangles.angle_rad),
            np.sin(rectangles.angle_rad),
            top_m,
            lidar_share,
            lidar_xy,
            kinds.class_ids,
            kinds.mean_m,
            kinds.limit_m,
            kinds.rarity,
            np.full(len(top_m), -1) if given_ids is None else np.ascontiguousarray(given_ids),
        )
    )


@compiled(
    "Tuple((int64[::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[::1], float64[:, ::1], float64[::1], "
    f"boolean[::1]))({_TABLE}, {_TABLE}, {_LIST}, {_LIST}, {_LIST}, {_LIST}, {_TABLE}, {_TABLE}, "
    f"Array(int64, 1, 'C', readonly=True), {_TABLE}, {_TABLE}, {_LIST}, Array(int64, 1, 'C', readonly=True))"
)
def _completed(
    low: F64,
    high: F64,
    angle_rad: F64,
    cos: F64,
    sin: F64,
    top_m: F64,
    lidar_share: F64,
    lidar_xy: F64,
    class_ids: I64,
    mean_m: F64,
    limit_m: F64,
    rarity: F64,
    given_ids: I64,
) -> tuple[I64, F64, F64, F64, F64, F64, F64, Bools]:
    """The fields of `CompletedBoxes`; `given_ids` are -1 where the class is to be chosen."""
    clusters, lidars = lidar_share.shape
    found, center_xy, sizes = np.empty(clusters, np.int64), np.empty((clusters, 2)), np.empty((clusters, 3))
    yaw_rad, misfit, std_m = np.empty(clusters), np.empty(clusters), np.empty((clusters, 2))
    faces_m2, rides = np.empty(clusters), np.empty(clusters, np.bool_)
    extent, middle, seen, measured, visible = np.empty(2), np.empty(2), np.empty(2), np.empty(3), np.empty(3)
    towards, full, center = np.empty((lidars, 2)), np.empty(2), np.empty(2)
    for c in range(clusters):
        for axis in range(2):
            extent[axis] = high[c, axis] - low[c, axis]
            middle[axis] = (high[c, axis] + low[c, axis]) / 2
            seen[axis] = 0.0
        for lidar in range(lidars):
            x, y = lidar_xy[lidar, 0], lidar_xy[lidar, 1]
            towards[lidar, 0] = (cos[c] * x + sin[c] * y) - middle[0]
            towards[lidar, 1] = (cos[c] * y - sin[c] * x) - middle[1]
            square_m2 = towards[lidar, 0] * towards[lidar, 0] + towards[lidar, 1] * towards[lidar, 1]
            distance_m = max(np.sqrt(square_m2), 1e-9)
            for axis in range(2):
                # The extent along one axis is visible on the side whose normal is the other axis.
                seen[1 - axis] += lidar_share[c, lidar] * abs(towards[lidar, axis] / distance_m)

        measured[0], measured[1], measured[2] = extent[0], extent[1], top_m[c]
        visible[0], visible[1], visible[2] = seen[0], seen[1], 1.0
        choice, least = 0, np.inf
        for k in range(len(class_ids)):
            off, fits = 0.0, True
            for axis in range(3):
                mean, limit = mean_m[k, axis], limit_m[k, axis]
                long = max(measured[axis] - mean, 0.0) / max((limit - mean) / 2, 1e-9)
                short = visible[axis] * max(mean - measured[axis], 0.0) / (SHORT_SHARE * mean)
                short = min(short, MAX_SHORT_SIGMAS)
                off += (long * long + short * short) / 2
                fits = fits and measured[axis] <= limit
            cost = off + rarity[k] if fits else np.inf
            if given_ids[c] >= 0:
                cost = off if class_ids[k] == given_ids[c] else np.inf
            if k == 0 or cost < least:
                choice, least, misfit[c] = k, cost, off
        found[c] = class_ids[choice] if least < np.inf else -1

        narrow, wide = mean_m[choice, 0], mean_m[choice, 1]
        narrow, wide, height = min(narrow, wide), max(narrow, wide), mean_m[choice, 2]
        is_slender, is_round = narrow <= MAX_SLENDER_SHARE * height, narrow > MAX_RIDER_SHARE * wide
        anchored = (PEDESTRIAN_ANCHOR if is_round else 0.0) if is_slender else 1.0
        rides[c] = is_slender and not is_round
        height = top_m[c] if top_m[c] >= WHOLE_SHARE * height else height
        turn = choice % 2  # 1: the length lies along the second axis
        for axis in range(2):
            mean, limit = mean_m[choice, axis], limit_m[choice, axis]
            reach_m, beyond, before, anchor = max(extent[axis], mean / 2) / 2, 0.0, 0.0, 0.0
            for lidar in range(lidars):
                # -1: the lidar is beyond the low end, 1: beyond the high end, between: beside the object.
                end, share = min(max(towards[lidar, axis] / reach_m, -1.0), 1.0), lidar_share[c, lidar]
                beyond += share if end > 0.5 else 0.0
                before += share if end < -0.5 else 0.0
                anchor += share * end
            is_whole = min(beyond, before) >= BOTH_ENDS_SHARE and extent[axis] >= BOTH_ENDS_WHOLE_SHARE * mean
            is_whole = is_whole or (seen[axis] > 0.5 and extent[axis] >= WHOLE_SHARE * mean)
            missing_m = 0.0 if is_whole and not is_slender else max(mean - extent[axis], 0.0)
            full[axis] = extent[axis] + missing_m
            # A grown side errs by the spread of the class; half of that moves the centre.
            std = min((limit - mean) / 4, missing_m) if missing_m > 0.0 else 0.0
            std_m[c, axis ^ turn] = (full[axis] - extent[axis]) / 4 if is_slender else std
            sizes[c, axis ^ turn] = full[axis]
            grown = middle[axis] - anchor * missing_m / 2
            center[axis] = middle[axis] + anchored * (grown - middle[axis])
        sizes[c, 2] = height
        faces_m2[c] = (seen[0] * full[0] + seen[1] * full[1]) * height
        center_xy[c, 0] = center[0] * cos[c] - center[1] * sin[c]
        center_xy[c, 1] = center[0] * sin[c] + center[1] * cos[c]
        yaw = angle_rad[c] + (np.pi / 2 if turn else 0.0)
        yaw_rad[c] = yaw - np.pi if yaw > np.pi / 2 else yaw
    return found, center_xy, sizes, yaw_rad, misfit, std_m, faces_m2, rides
