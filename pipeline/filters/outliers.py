"""Statistical outlier removal, with the rule and arithmetic of PCL's StatisticalOutlierRemoval; rain and snow.

Source: Rusu et al., Towards 3D Point Cloud Based Object Maps for Household Environments (2008), section 5.1, as
implemented in PCL 1.8 and later. Open3D's filter differs: it counts the point among its own neighbours and removes
exact duplicates.

Rain, snow and dust return single points in the air near the lidar. As far objects have few points, the limit for these
grows with range (Charron, Phillips, Waslander: De-noising of lidar point clouds corrupted by snowfall, CRV 2018); here
it follows from the cloud itself.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, U8, Bools
from lidcam.pipeline.native.kernels import mean_neighbor_distance_m

NEIGHBORS = 10
"""Nearest neighbours to which a point's distance is averaged, without the point itself."""


RANGE_GROWTH = 1.5
"""Ratio of the ends of a band of ranges, whose points are about as far apart."""

AIR_RATIO = 6.0
"""Minimum mean distance of a point in the air, as a multiple of the median of its lidar's points at its range: 98 % of
the points of near cars in a KITTI drive are below, and 90 % of simulated snow above."""

MAX_SPACING_M = 0.12
"""Maximum of that median: in wider bands people have too few points for `NEIGHBORS`."""

MIN_BAND_POINTS = 100
"""Minimum number of points of a band."""

MIN_AIR_SHARE = 0.003
"""Minimum share of points in the air: in clear weather up to 0.0012 are far from others, at the rims of objects."""


def neighbor_distance_m(xyz: F32) -> F32:
    """(N,) mean distance of each of the finite points (N, 3) to its `NEIGHBORS` nearest; 0 in a cloud of no more.

    Exact duplicates are neighbours at distance 0.
    """
    if len(xyz) <= NEIGHBORS:
        return np.zeros(len(xyz), np.float32)
    return mean_neighbor_distance_m(np.ascontiguousarray(xyz), NEIGHBORS)


def statistical_inliers(mean_distance_m: F32, *, std_ratio: float) -> Bools:
    """(N,) whether to keep each point, by its `neighbor_distance_m`.

    A point is kept if that is at most its mean over the cloud plus `std_ratio` times its sample standard deviation. A
    cloud of `NEIGHBORS` points or fewer is kept whole (PCL reads past its results there).
    """
    count = len(mean_distance_m)
    if count <= NEIGHBORS:
        return np.ones(count, np.bool_)
    # PCL's arithmetic: a point's mean distance and its square in float32, sums over the cloud in float64.
    total = float(mean_distance_m.sum(dtype=np.float64))
    total_of_squares = float((mean_distance_m * mean_distance_m).sum(dtype=np.float64))
    variance = max(total_of_squares - total * total / count, 0.0) / (count - 1)
    keep: Bools = mean_distance_m <= np.float64(total / count + std_ratio * variance**0.5)
    return keep


def points_in_air(mean_distance_m: F32, range_m: F32, lidar_index: U8) -> Bools:
    """(N,) whether each point is of rain, snow or dust; none in clear weather.

    Args:
        mean_distance_m: (N,) `neighbor_distance_m` of each point.
        range_m: (N,) distance of each from its lidar, positive.
        lidar_index: (N,) lidar of each.
    """
    band = (np.log(range_m) / np.float32(np.log(RANGE_GROWTH))).astype(np.int32)
    group = (band - band.min(initial=0)) * (1 + int(lidar_index.max(initial=0))) + lidar_index
    by_group = mean_distance_m[np.argsort(group.astype(np.uint16), kind="stable")]
    parts = np.split(by_group, np.cumsum(np.bincount(group))[:-1])
    median_m = np.array([np.median(one) if len(one) >= MIN_BAND_POINTS else np.inf for one in parts])
    limit_m = np.where(median_m <= MAX_SPACING_M, AIR_RATIO * median_m, np.inf).astype(np.float32)
    found = mean_distance_m > limit_m[group]
    return found if found.sum() >= MIN_AIR_SHARE * len(found) else np.zeros_like(found)
