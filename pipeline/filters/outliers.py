"""Statistical outlier removal, with the rule and arithmetic of PCL's StatisticalOutlierRemoval.

Source: Rusu et al., Towards 3D Point Cloud Based Object Maps for Household Environments (2008), section 5.1, as
implemented in PCL 1.8 and later. Open3D's filter differs: it counts the point among its own neighbours and removes
exact duplicates.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, Bools
from lidcam.pipeline.native.kernels import mean_neighbor_distance_m

NEIGHBORS = 10
"""Nearest neighbours to which a point's distance is averaged, without the point itself."""


def statistical_inliers(xyz: F32, *, std_ratio: float) -> Bools:
    """(N,) whether to keep each of the finite points (N, 3).

    A point is kept if the mean distance to its `NEIGHBORS` nearest is at most the mean of that distance over
    the cloud plus `std_ratio` times its sample standard deviation. Exact duplicates are neighbours at distance 0. A
    cloud of `NEIGHBORS` points or fewer is kept whole (PCL reads past its results there).
    """
    if len(xyz) <= NEIGHBORS:
        return np.ones(len(xyz), np.bool_)
    # PCL's arithmetic: a point's mean distance and its square in float32, sums over the cloud in float64.
    mean_distance_m = mean_neighbor_distance_m(np.ascontiguousarray(xyz), NEIGHBORS)
    count = len(xyz)
    total = float(mean_distance_m.sum(dtype=np.float64))
    total_of_squares = float((mean_distance_m * mean_distance_m).sum(dtype=np.float64))
    variance = max(total_of_squares - total * total / count, 0.0) / (count - 1)
    keep: Bools = mean_distance_m <= np.float64(total / count + std_ratio * variance**0.5)
    return keep
