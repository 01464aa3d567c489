"""Thinning and range-aware single-linkage clustering of a lidar cloud.

Two points are linked if they are nearer than a distance that grows with their range, because points thin out with
range. The caller may scale down heights, so that a roof is linked to its bonnet and the rings of a sparse lidar to each
other, but a tree not to the car below.

The result does not depend on the order of the points: coordinates are rounded to a binary fraction of a metre, which
makes their sums exact, and all further steps are ordered by grid cell.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.native.kernels import cells_of_points, linked_parts

HEIGHT_WEIGHT = 0.5
"""Weight of a vertical metre in link distances; a horizontal metre counts 1."""

LINK_CELL_SHARE = 0.6
"""Edge of the linked cells, as a share of the link distance; finer cells cost more and change little."""

LEVEL_GROWTH = 1.5
"""Ratio of the edges of neighbouring levels of the grid."""

SEARCH_GROWTH = 4.0
"""Ratio of the distances of neighbouring levels in the search: most clouds have one, as searching each takes longer
than searching some points too many; but one far point is not to make all others look far."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Points grouped by the cells of a grid, in order of cell."""

    means: F64  # (M, 3) float64 mean of each cell's points, metres
    distance_m: F64  # (M,) float64 smallest link distance of each cell's points
    counts: I64  # (M,) int64 number of points in each cell
    first: I64  # (M,) int64 first point of each cell
    cell_of_point: I64  # (N,) int64 cell of each point


def thin_points(points: F64, distance_m: F64, share: float, group: I64 | None = None) -> Cells:
    """Group at least one point by the cells of a grid of varying size.

    Args:
        points: (N, 3) metres.
        distance_m: (N,) link distance at each point, positive.
        share: Edge of the cell at a point, as a share of this distance; rounded down to the next of a series of sizes.
        group: (N,) group of each point, from 0; different groups share no cell.
    """
    group = np.zeros(len(points), np.int64) if group is None else group
    edges_m = _series(share * distance_m.min(), share * distance_m.max(), LEVEL_GROWTH)
    points = np.ascontiguousarray(points)
    return Cells(*cells_of_points(points, distance_m, share, edges_m, group, int(group.max()) + 1))


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
    cells = thin_points(points, link_distance_m, LINK_CELL_SHARE)
    series = _series(cells.distance_m.min(), cells.distance_m.max(), SEARCH_GROWTH)
    count, cluster_of_cell = linked_parts(cells.means, cells.distance_m, series)
    return count, cluster_of_cell[cells.cell_of_point]


def _series(first: float, last: float, growth: float) -> F64:
    """A geometric series from `first` up to `last`."""
    steps = [first]
    while steps[-1] * growth <= last < np.inf:
        steps.append(first * growth ** len(steps))
    return np.array(steps)
