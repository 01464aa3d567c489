"""Thinning, clustering and L-shape search by array operations and scipy: the judge of the compiled loops."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pipeline.core.arrays import F64, I64
from pipeline.detectors.cluster.clusters import LEVEL_GROWTH, LINK_CELL_SHARE, Cells

__all__ = ["judged_cells", "judged_clusters"]

RESOLUTION_PER_M = 8192.0


def judged_cells(points: F64, distance_m: F64, share: float, group: I64 | None = None) -> Cells:
    """As `clusters.thin_points`."""
    exact = np.rint(np.ascontiguousarray(points.T) * RESOLUTION_PER_M) / RESOLUTION_PER_M
    level, edge_m = _levels(share * distance_m)
    cell = np.floor(exact / edge_m[level]).astype(np.int64)
    cell -= cell.min(1, keepdims=True)
    span = cell.max(1) + 1
    key = level if group is None else level * (int(group.max()) + 1) + group
    for axis in range(3):
        key = key * span[axis] + cell[axis]
    members = np.argsort(key.astype(np.uint64), kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], np.diff(key[members]) != 0]))
    counts = np.diff(starts, append=len(key))
    means = np.add.reduceat(exact.take(members, axis=1), starts, axis=1) / counts
    cell_of_point = np.empty(len(members), np.int64)
    cell_of_point[members] = np.repeat(np.arange(len(starts)), counts)
    least_m = np.minimum.reduceat(distance_m[members], starts)
    return Cells(np.ascontiguousarray(means.T), least_m, counts, members[starts], cell_of_point)


def judged_clusters(points: F64, link_distance_m: F64) -> tuple[int, I64]:
    """As `clusters.cluster_points`."""
    if not len(points):
        return 0, np.zeros(0, np.int64)
    cells = judged_cells(points, link_distance_m, LINK_CELL_SHARE)
    pairs = _near_pairs(cells.means, cells.distance_m)
    size = len(cells.counts)
    graph = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(size, size))
    count, cluster_of_cell = connected_components(graph.tocsr(), directed=False)
    return int(count), cluster_of_cell.astype(np.int64)[cells.cell_of_point]


def _near_pairs(means: F64, distance_m: F64) -> I64:
    level, _ = _levels(distance_m)
    found = [np.zeros((2, 0), np.int64)]
    for lowest in np.unique(level):
        rows = np.flatnonzero(level >= lowest)
        reach = float(distance_m[level == lowest].max())
        pairs = cKDTree(means[rows]).query_pairs(reach * (1 + 1e-9), output_type="ndarray")
        a, b = rows[pairs.T]
        x, y, z = (means[a] - means[b]).T
        near = x**2 + y**2 + z**2 <= np.minimum(distance_m[a], distance_m[b]) ** 2
        found.append(np.stack([a[near], b[near]]))
    return np.concatenate(found, 1)


def _levels(distance_m: F64) -> tuple[I64, F64]:
    least, most = float(distance_m.min()), float(distance_m.max())
    series = least * LEVEL_GROWTH ** np.arange(int(np.log(most / least) / np.log(LEVEL_GROWTH)) + 2)
    return np.asarray(np.searchsorted(series, distance_m, side="right") - 1, np.int64), np.asarray(series, np.float64)
