"""The engine: from the points above the ground to proposed boxes."""

import numpy as np

from pipeline.core.arrays import F64, I64, select_rows
from pipeline.core.clouds import CombinedCloud
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster.clusters import cluster_points
from pipeline.detectors.cluster.fitting import BoxFitter, ThinnedPoints
from pipeline.detectors.protocols import Candidates3D

__all__ = ["ClusterDetector"]


CEILING_SHARE = 1.15
"""Points above this multiple of the tallest class are left out: a cluster that reaches it is too tall for any class."""

GOOD_MISFIT = 1.0
"""A cluster that fits its size prior worse than this may be several objects: it is also tried in parts."""


class ClusterDetector:
    """Proposes boxes of the configured classes by clustering, L-shape fitting and size priors.

    Boxes stand on the ground, or where none was found at the rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud
    does not tell front from rear.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        self._fitter = BoxFitter(rig, config)
        self._config = config.detect3d.cluster
        limits = np.array([prior.max_size_m for prior in config.classes])
        self._ceiling_m = float(limits[:, 2].max()) * CEILING_SHARE
        self._diagonal_m = float(np.hypot(limits[:, 0], limits[:, 1]).max())

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of all clusters, and of the parts of those that fit no class well."""
        points = self._points_above_ground(combined)
        parts, cluster = [Candidates3D.empty()], np.full(len(points.position), -1)
        for share in (1.0, *self._config.split_shares):
            if len(points.position):
                candidates, points, cluster = self._candidates(points, cluster, share)
                parts.append(candidates)
        found = Candidates3D(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return self._fitter.on_ground(combined, found)

    def _points_above_ground(self, combined: CombinedCloud) -> ThinnedPoints:
        position = combined.detection_cloud.xyz.astype(np.float64)
        position[:, 2] -= self._fitter.ground_m(combined, position[:, :2])
        height = position[:, 2]
        rows = np.flatnonzero((height > self._config.clearance_m) & (height < self._ceiling_m))
        points, _ = self._fitter.thin(combined, rows, position.take(rows, axis=0))
        return points

    def _candidates(self, points: ThinnedPoints, before: I64, share: float) -> tuple[Candidates3D, ThinnedPoints, I64]:
        """Boxes of the clusters at a share of the link distance; and the points of those to try in parts, with these.

        The boxes' centres are given as height above the ground. A cluster that did not fall apart gets no second box.

        Args:
            points: Points above the ground.
            before: (N,) the cluster in which each was before; -1 in none.
            share: Share of the link distance.
        """
        weighted = points.position * np.array([1.0, 1.0, self._config.height_weight])
        count, cluster = cluster_points(weighted, share * points.link_distance_m)
        order = np.argsort(cluster, kind="stable")
        points, cluster, before = select_rows(points, order), cluster[order], before[order]
        starts = np.searchsorted(cluster, np.arange(count))
        height = points.position[:, 2]
        usable = (
            (np.add.reduceat(points.weights, starts) >= self._config.min_points)
            & (np.maximum.reduceat(height, starts) >= self._config.min_height_m)
            & (np.minimum.reduceat(height, starts) <= self._config.max_bottom_m)
        )
        in_parts = np.bincount(before + 1)[before[starts] + 1] > np.diff(starts, append=len(cluster))
        small = usable & (in_parts | (before[starts] < 0))
        small &= _diameter(points.position[:, :2], starts) <= self._diagonal_m
        rows = np.flatnonzero(small[cluster])
        small_starts = np.searchsorted(cluster[rows], np.flatnonzero(small))
        candidates, misfit = self._fitter.fit(select_rows(points, rows), small_starts)
        again = usable.copy()
        again[small] = (candidates.class_ids < 0) | (misfit > GOOD_MISFIT)
        rows = np.flatnonzero(again[cluster])
        return candidates, select_rows(points, rows), cluster[rows]


def _diameter(xy: F64, starts: I64) -> F64:
    """(C,) lower bound of the diameter of each cluster: its largest extent in four directions."""
    x, y = xy.T
    half = np.sqrt(0.5)
    extents = [
        np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
        for along in (x, y, (x + y) * half, (x - y) * half)
    ]
    return np.asarray(np.max(extents, axis=0))
