"""Statistical outlier removal, with the rule and arithmetic of PCL's StatisticalOutlierRemoval.

Source: Rusu et al., Towards 3D Point Cloud Based Object Maps for Household Environments (2008), section 5.1, as
implemented in PCL 1.8 and later. Open3D's filter differs: it counts the point among its own neighbours and removes
exact duplicates.
"""

import numpy as np
from pykdtree.kdtree import KDTree

from pipeline.core.arrays import F32, Array, Bools

__all__ = ["statistical_inliers"]

QUERY_POINTS = 1 << 16
"""Points whose neighbours are sought at once: each takes a hundred bytes meanwhile."""

TREE_BYTES = 64
"""Memory of the tree for a point, at most."""

CROWD = 500
"""Points at one place: the tree cannot part them, so the search takes the square of their number."""

LEAF_SIZE = 16
"""Points per leaf of the search tree; fastest on clouds of 30 000 to 115 000 points. Does not change the result."""


def statistical_inliers(xyz: F32, *, neighbors: int, std_ratio: float) -> Bools:
    """(N,) true for the points to keep.

    A point is kept if the mean distance to its `neighbors` nearest neighbours is at most the mean of that distance over
    the cloud plus `std_ratio` times its sample standard deviation. Exact duplicates are neighbours at distance 0. A
    cloud of `neighbors` points or fewer is kept whole (PCL reads past its results there).

    Args:
        xyz: (N, 3) metres, finite.
        neighbors: At least 1; the point itself does not count.
        std_ratio: May be negative.
    """
    if len(xyz) <= neighbors:
        return np.ones(len(xyz), np.bool_)
    # PCL's arithmetic: a point's mean distance and its square in float32, sums over the cloud in float64.
    mean_distance_m = _mean_neighbor_distance(xyz, neighbors)
    count = len(xyz)
    total = float(mean_distance_m.sum(dtype=np.float64))
    total_of_squares = float((mean_distance_m * mean_distance_m).sum(dtype=np.float64))
    variance = max(total_of_squares - total * total / count, 0.0) / (count - 1)
    keep: Bools = mean_distance_m <= np.float64(total / count + std_ratio * variance**0.5)
    return keep


def _mean_neighbor_distance(xyz: F32, neighbors: int) -> F32:
    if _may_crowd(xyz):
        return _among_crowds(xyz, neighbors)
    return _by_tree(xyz, xyz, neighbors)


def _by_tree(points: F32, xyz: F32, neighbors: int) -> F32:
    """(N,) mean distance of `xyz` to the nearest `points`, which include them."""
    np.empty(TREE_BYTES * len(points), np.uint8)  # pykdtree crashes where it gets no memory: ask for it first
    tree = KDTree(points, leafsize=LEAF_SIZE)
    means = np.empty(len(xyz), np.float32)
    for start in range(0, len(xyz), QUERY_POINTS):
        found: tuple[F32, Array] = tree.query(xyz[start : start + QUERY_POINTS], k=neighbors + 1)
        distances = found[0]
        total = np.zeros(len(distances))
        for neighbor in range(1, neighbors + 1):  # 0 is the point itself, or a duplicate of it
            total += distances[:, neighbor]
        means[start : start + QUERY_POINTS] = total / neighbors
    return means


def _may_crowd(xyz: F32) -> bool:
    """Whether `CROWD` points have one x: a quick look, as nearly no cloud has."""
    x = np.sort(xyz[:, 0])
    return bool((x[CROWD:] == x[:-CROWD]).any())


def _among_crowds(xyz: F32, neighbors: int) -> F32:
    """The same for a cloud with many points at one place: those with enough duplicates are at distance 0."""
    order = np.lexsort(xyz.T)
    starts = np.flatnonzero(np.append(True, (xyz[order[1:]] != xyz[order[:-1]]).any(1)))
    counts = np.diff(starts, append=len(order))
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    alone = np.repeat(counts, counts) <= neighbors
    means = np.zeros(len(xyz), np.float32)
    if alone.any():
        points = xyz[order[rank <= neighbors]]  # more duplicates of a point change nothing
        means[order[alone]] = _by_tree(points, xyz[order[alone]], neighbors)
    return means
