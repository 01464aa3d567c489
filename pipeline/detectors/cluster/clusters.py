"""Thinning and range-aware single-linkage clustering of a lidar cloud.

Two points are linked if they are nearer than a distance that grows with their range, because points thin out with
range. The caller may scale down heights, so that a roof is linked to its bonnet and the rings of a sparse lidar to each
other, but a tree not to the car below.

The result does not depend on the order of the points: coordinates are rounded to a binary fraction of a metre, which
makes their sums exact, and all further steps are ordered by grid cell.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pipeline.core.arrays import F64, I64

__all__ = ["Cells", "cluster_points", "thin_points"]


RESOLUTION_PER_M = 8192.0
"""Coordinates are rounded to this fraction of a metre (0.12 mm), so float64 adds up a million of them exactly."""

LINK_CELL_SHARE = 0.6
"""Edge of the linked cells, as a share of the link distance; finer cells cost more and change little."""

LEVEL_GROWTH = 1.5
"""Ratio of the distances of neighbouring levels, in the grid and in the search."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Points grouped by the cells of a grid, in order of cell.

    Attributes:
        means: (M, 3) float64 mean of each cell's points, metres.
        counts: (M,) int64 number of points in each cell.
        members: (N,) int64 rows of the points, cell after cell.
        starts: (M,) int64 start of each cell in `members`.
    """

    means: F64
    counts: I64
    members: I64
    starts: I64

    @property
    def cell_of_point(self) -> I64:
        """(N,) cell of each point."""
        cells = np.empty(len(self.members), np.int64)
        cells[self.members] = np.repeat(np.arange(len(self.starts)), self.counts)
        return cells


def thin_points(points: F64, cell_m: F64, group: npt.NDArray[np.integer] | None = None) -> Cells:
    """Group at least one point by the cells of a grid of varying size.

    Args:
        points: (N, 3) metres.
        cell_m: (N,) edge of the cell at each point, rounded down to the next of a series of sizes.
        group: (N,) group of each point, from 0; different groups share no cell.
    """
    # A row per coordinate: several times faster than rows of three.
    exact = np.rint(np.ascontiguousarray(points.T) * RESOLUTION_PER_M) / RESOLUTION_PER_M
    level = _levels(cell_m)
    edge_m = cell_m.min() * LEVEL_GROWTH ** np.arange(level.max() + 1)
    cell = np.floor(exact / edge_m[level]).astype(np.int64)
    cell -= cell.min(1, keepdims=True)
    span = cell.max(1) + 1
    key = level if group is None else level * (int(group.max()) + 1) + group
    for axis in range(3):
        key = key * span[axis] + cell[axis]
    members = np.argsort(key, kind="stable")  # fast where neighbours in a scan are neighbours in space
    starts = np.flatnonzero(np.diff(key[members], prepend=-1))
    counts = np.diff(starts, append=len(key))
    means = np.add.reduceat(exact.take(members, axis=1), starts, axis=1) / counts
    return Cells(np.ascontiguousarray(means.T), counts, members, starts)


def cluster_points(points: F64, link_distance_m: F64) -> tuple[int, I64]:
    """Split points into clusters further apart than the link distance.

    Points are grouped by cells of about half the link distance. Two cells are linked if the distance of their means is
    at most the smaller of their link distances.

    Args:
        points: (N, 3) metres.
        link_distance_m: (N,) link distance at each point, positive.

    Returns:
        The number of clusters, and the cluster of each point (N,), numbered in order of their first cell.
    """
    if not len(points):
        return 0, np.zeros(0, np.int64)
    cells = thin_points(points, LINK_CELL_SHARE * link_distance_m)
    distance_m = np.minimum.reduceat(link_distance_m[cells.members], cells.starts)
    edges = _near_pairs(cells.means, distance_m)
    size = len(cells.starts)
    graph = coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=(size, size))
    count, cluster_of_cell = connected_components(graph.tocsr(), directed=False)
    return int(count), cluster_of_cell.astype(np.int64)[cells.cell_of_point]


def _near_pairs(means: F64, distance_m: F64) -> I64:
    """(2, E) pairs at most the smaller of their link distances apart.

    Searched level by level, so that the wide search of far cells leaves out the near ones: each pair is found at the
    level of its smaller distance, which includes both.
    """
    level = _levels(distance_m)
    columns = np.ascontiguousarray(means.T)
    found = [np.zeros((2, 0), np.int64)]
    for lowest in np.unique(level):
        rows = np.flatnonzero(level >= lowest)
        reach = float(distance_m[level == lowest].max())
        tree = cKDTree(means[rows], balanced_tree=False, compact_nodes=False)
        a, b = rows.take(tree.query_pairs(reach, output_type="ndarray").T)
        x, y, z = columns.take(a, axis=1) - columns.take(b, axis=1)
        near = x**2 + y**2 + z**2 <= np.minimum(distance_m.take(a), distance_m.take(b)) ** 2
        found.append(np.stack([a[near], b[near]]))
    return np.concatenate(found, 1)


def _levels(distance_m: F64) -> I64:
    """(N,) step of each distance in a geometric series that starts at the smallest one."""
    steps = np.log(distance_m / distance_m.min()) / np.log(LEVEL_GROWTH)
    return np.asarray(np.floor(steps), np.int64)
