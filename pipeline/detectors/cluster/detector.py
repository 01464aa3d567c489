"""The engine: from the points above the ground to proposed boxes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Bools, select_rows
from pipeline.core.clouds import CombinedCloud
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster.clusters import cluster_points, thin_points
from pipeline.detectors.cluster.completion import complete_boxes
from pipeline.detectors.cluster.lshape import fit_rectangles, quantiles_by_cluster
from pipeline.detectors.cluster.scores import box_covariances, box_scores
from pipeline.detectors.protocols import Candidates3D

__all__ = ["ClusterDetector"]


CEILING_SHARE = 1.15
"""Points above this multiple of the tallest class are left out: a cluster that reaches it is too tall for any class."""

THIN_SHARE = 0.2
"""Points in a cell of this share of the link distance become one: dense surfaces say no more than sparse ones."""

TOP_SHARE = 0.99
"""Share of a cluster's points below its top; the rest may be stray points."""

BATCH_POINTS = 1 << 16
"""Points whose clusters are measured at once: the search over headings takes kilobytes for each."""

GOOD_MISFIT = 1.0
"""A cluster that fits its size prior worse than this may be several objects: it is also tried in parts."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Thinned points above the ground.

    Attributes:
        position: (N, 3) x, y in the site frame and height above the ground, metres.
        link_distance_m: (N,).
        lidar: (N,) lidar that measured the point.
        weights: (N,) number of measured points that it stands for.
    """

    position: F64
    link_distance_m: F64
    lidar: I64
    weights: I64


class ClusterDetector:
    """Proposes boxes of the configured classes by clustering, L-shape fitting and size priors.

    Boxes stand on the ground plane, or without one at the rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud does
    not tell front from rear.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        self._lidar_xyz = np.stack([lidar.T_site_lidar.translation for lidar in rig.lidars])
        self._ground_height_m = rig.ground_height_m or 0.0
        self._config = config.detect3d.cluster
        self._priors = config.classes
        limits = np.array([prior.max_size_m for prior in config.classes])
        self._ceiling_m = float(limits[:, 2].max()) * CEILING_SHARE
        self._diagonal_m = float(np.hypot(limits[:, 0], limits[:, 1]).max())

    def __call__(self, combined: CombinedCloud) -> Candidates3D:
        """Boxes of all clusters, and of the parts of those that fit no class well."""
        points = self._points_above_ground(combined)
        parts = [Candidates3D.empty()]
        for share in (1.0, *self._config.split_shares):
            if len(points.position):
                candidates, points = self._candidates(points, share)
                parts.append(candidates)
        found = Candidates3D(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        ground_m = self._ground_m(combined, np.ascontiguousarray(found.centers[:, :2]))
        return found._replace(centers=np.column_stack([found.centers[:, :2], ground_m + found.centers[:, 2]]))

    def _ground_m(self, combined: CombinedCloud, xy: F64) -> F64:
        if combined.plane is None:
            return np.full(len(xy), self._ground_height_m)
        return combined.plane.height_m(xy)

    def _points_above_ground(self, combined: CombinedCloud) -> _Points:
        xyz = combined.detection_cloud.xyz.astype(np.float64)
        height = xyz[:, 2] - self._ground_m(combined, xyz[:, :2])
        rows = np.flatnonzero((height > self._config.clearance_m) & (height < self._ceiling_m))
        xyz, lidar = xyz.take(rows, axis=0), combined.detection_lidar_index[rows].astype(np.int64)
        gap = xyz - self._lidar_xyz.take(lidar, axis=0)
        range_m = np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2 + gap[:, 2] ** 2)
        link_m = self._config.distance_m + self._config.distance_per_m * range_m
        if not len(rows):
            return _Points(xyz, link_m, lidar, lidar)
        xyz[:, 2] = height[rows]
        cells = thin_points(xyz, THIN_SHARE * link_m, lidar)
        link_m = np.minimum.reduceat(link_m[cells.members], cells.starts)
        return _Points(cells.means, link_m, lidar[cells.members[cells.starts]], cells.counts)

    def _candidates(self, points: _Points, share: float) -> tuple[Candidates3D, _Points]:
        """Boxes of the clusters at a share of the link distance, and the points of clusters to try in parts.

        The boxes' centres are given as height above the ground.
        """
        weighted = points.position * np.array([1.0, 1.0, self._config.height_weight])
        count, cluster = cluster_points(weighted, share * points.link_distance_m)
        order = np.argsort(cluster, kind="stable")
        points, cluster = select_rows(points, order), cluster[order]
        starts = np.searchsorted(cluster, np.arange(count))
        height = points.position[:, 2]
        usable = (
            (np.add.reduceat(points.weights, starts) >= self._config.min_points)
            & (np.maximum.reduceat(height, starts) >= self._config.min_height_m)
            & (np.minimum.reduceat(height, starts) <= self._config.max_bottom_m)
        )
        small = usable & (_diameter(points.position[:, :2], starts) <= self._diagonal_m)
        candidates, again = Candidates3D.empty(), usable.copy()
        if small.any():
            rows = np.flatnonzero(small[cluster])
            small_starts = np.searchsorted(cluster[rows], np.flatnonzero(small))
            batches = [*self._in_batches(select_rows(points, rows), small_starts)]
            candidates = Candidates3D(*map(np.concatenate, zip(*(found for found, _ in batches), strict=True)))
            again[small] = np.concatenate([doubtful for _, doubtful in batches])
        return candidates, select_rows(points, np.flatnonzero(again[cluster]))

    def _in_batches(self, points: _Points, starts: I64) -> Iterator[tuple[Candidates3D, Bools]]:
        """As `_measured`, of a number of clusters at a time."""
        ends = np.append(starts[1:], len(points.position))
        first = 0
        while first < len(starts):
            last = max(int(np.searchsorted(ends, starts[first] + BATCH_POINTS, side="right")), first + 1)
            rows = np.arange(starts[first], ends[last - 1])
            yield self._measured(select_rows(points, rows), starts[first:last] - starts[first])
            first = last

    def _measured(self, points: _Points, starts: I64) -> tuple[Candidates3D, Bools]:
        """Completed boxes of clusters, for points sorted by cluster; and which of them may be several objects."""
        counts = np.add.reduceat(points.weights, starts)
        rectangles = fit_rectangles(points.position[:, :2], starts)
        (top,) = quantiles_by_cluster(points.position[:, 2], starts, (TOP_SHARE,))
        by_lidar = points.weights[:, None] * (points.lidar[:, None] == np.arange(len(self._lidar_xyz)))
        lidar_share = np.add.reduceat(by_lidar, starts) / counts[:, None]
        boxes = complete_boxes(rectangles, top, lidar_share, self._lidar_xyz[:, :2], self._priors)
        range_m = np.linalg.norm(boxes.center_xy[:, None] - self._lidar_xyz[:, :2], axis=2)
        expected_per_m2 = self._config.points_per_sr * (lidar_share / np.maximum(range_m, 1e-3) ** 2).sum(1)
        candidates = Candidates3D(
            np.column_stack([boxes.center_xy, boxes.sizes[:, 2] / 2]),
            boxes.sizes,
            boxes.yaw_rad,
            box_scores(boxes, rectangles, counts, expected_per_m2),
            boxes.class_ids,
            counts,
            box_covariances(boxes, rectangles),
        )
        return candidates, (boxes.class_ids < 0) | (boxes.misfit > GOOD_MISFIT)


def _diameter(xy: F64, starts: I64) -> F64:
    """(C,) lower bound of the diameter of each cluster: its largest extent in four directions."""
    x, y = xy.T
    half = np.sqrt(0.5)
    extents = [
        np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
        for along in (x, y, (x + y) * half, (x - y) * half)
    ]
    return np.asarray(np.max(extents, axis=0))
