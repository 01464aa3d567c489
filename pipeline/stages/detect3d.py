"""Detection in the cloud: what is left above the ground becomes boxes of road users, without any weights."""

from dataclasses import dataclass, fields

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster import cluster_points, thin_points
from pipeline.detectors.completion import CompletedBoxes, complete_boxes
from pipeline.detectors.lshape import Rectangles, fit_rectangles, quantiles_by_cluster

__all__ = ["Detect3D"]


CEILING_SHARE = 1.15
"""Points above this multiple of the tallest class are left out: what is cut off there is too tall for every class."""

THIN_SHARE = 0.2
"""Cells of this share of the link distance make one point: dense surfaces say no more than sparse ones."""

TOP_SHARE = 0.99
"""Share of a cluster's points that lie below its top: single stray points are none of it."""

GOOD_MISFIT = 1.0
"""A cluster that fits its size prior worse than this may be several objects: it is also tried in parts."""

SURFACE_STD_SHARE = 0.05
"""Standard deviation of a seen side's position, as a share of the box's width."""

YAW_STD_MIN_RAD = np.deg2rad(1.0)
YAW_STD_MAX_RAD = np.pi / 4

FULL_VIEW_SHARE = 0.25
"""An object that returns this share of what it would in full view gets half of the best score: black paint returns
little, and others stand in front."""

ROUGH_SHARE = 0.15
"""A residual of this share of the box's mean side takes the score down to 1/e: bushes are rough, vehicles are not."""

OVERLAP_SHARE = 0.25
"""Of two boxes where one has more than this share of its ground inside the other, only the better one is an object."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Thinned points above the ground.

    Attributes:
        position: (N, 3) x, y in the site frame and height above the ground, metres.
        link_distance_m: (N,).
        lidar: (N,) lidar that measured the point.
        weights: (N,) measured points that it stands for.
    """

    position: F64
    link_distance_m: F64
    lidar: I64
    weights: I64

    def select(self, rows: I64) -> "_Points":
        return _Points(*(getattr(self, field.name).take(rows, axis=0) for field in fields(self)))


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Completed boxes of C clusters and what speaks for them."""

    boxes: CompletedBoxes
    scores: F64
    yaw_std_rad: F64
    counts: I64


class Detect3D:
    """Boxes of the configured classes in the combined cloud, by clustering, L-shape fitting and size priors."""

    def __init__(self, rig: Rig, config: Config) -> None:
        """Take the lidars' positions from the rig, and sizes and distances from the settings."""
        self._site_frame = rig.site_frame
        self._lidar_xyz = np.stack([lidar.T_site_lidar.translation for lidar in rig.lidars])
        self._ground_height_m = rig.ground_height_m or 0.0
        self._config = config.detect3d
        self._priors = config.classes
        limits = np.array([prior.size_max_m for prior in config.classes])
        self._ceiling_m = float(limits[:, 2].max()) * CEILING_SHARE
        self._diagonal_m = float(np.hypot(limits[:, 0], limits[:, 1]).max())

    def __call__(self, combined: CombinedCloud) -> Boxes3D:
        """Boxes in the site frame, in order of falling score, then of x and y.

        The order of the points does not matter. Boxes stand on the ground: the plane, or, where there is none, the
        rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud does not tell front from rear.
        """
        nothing = Boxes3D.empty(combined.cloud.stamp_ns, self._site_frame)
        if self._config.method == "none":
            return nothing
        points = self._points_above_ground(combined)
        found = []
        for share in (1.0, *self._config.split_shares):
            if len(points.position):
                candidates, points = self._candidates(points, share)
                found.extend(candidates)
        return self._boxes(_joined(found), combined) if found else nothing

    def _ground_m(self, combined: CombinedCloud, xy: F64) -> F64:
        if combined.plane is None:
            return np.full(len(xy), self._ground_height_m)
        return combined.plane.height_m(xy)

    def _points_above_ground(self, combined: CombinedCloud) -> _Points:
        xyz = combined.cloud.xyz.astype(np.float64)
        height = xyz[:, 2] - self._ground_m(combined, xyz[:, :2])
        rows = np.flatnonzero((height > self._config.clearance_m) & (height < self._ceiling_m))
        xyz, lidar = xyz.take(rows, axis=0), combined.lidar_index[rows].astype(np.int64)
        gap = xyz - self._lidar_xyz.take(lidar, axis=0)
        range_m = np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2 + gap[:, 2] ** 2)
        link_m = self._config.cluster_distance_m + self._config.cluster_distance_per_m * range_m
        if not len(rows):
            return _Points(xyz, link_m, lidar, lidar)
        xyz[:, 2] = height[rows]
        cells = thin_points(xyz, THIN_SHARE * link_m, lidar)
        link_m = np.minimum.reduceat(link_m[cells.members], cells.starts)
        return _Points(cells.means, link_m, lidar[cells.members[cells.starts]], cells.counts)

    def _candidates(self, points: _Points, share: float) -> tuple[list[_Candidates], _Points]:
        """Boxes of the clusters at a share of the link distance, and the points of clusters to try in parts."""
        weighted = points.position * np.array([1.0, 1.0, self._config.height_weight])
        count, cluster = cluster_points(weighted, share * points.link_distance_m)
        order = np.argsort(cluster, kind="stable")
        points, cluster = points.select(order), cluster[order]
        starts = np.searchsorted(cluster, np.arange(count))
        height = points.position[:, 2]
        usable = (
            (np.add.reduceat(points.weights, starts) >= self._config.min_points)
            & (np.maximum.reduceat(height, starts) >= self._config.min_height_m)
            & (np.minimum.reduceat(height, starts) <= self._config.max_bottom_m)
        )
        small = usable & (_diameter(points.position[:, :2], starts) <= self._diagonal_m)
        again = usable.copy()
        if not small.any():
            return [], points.select(np.flatnonzero(again[cluster]))
        rows = np.flatnonzero(small[cluster])
        candidates = self._measured(points.select(rows), np.searchsorted(cluster[rows], np.flatnonzero(small)))
        again[small] = (candidates.boxes.class_ids < 0) | (candidates.boxes.misfit > GOOD_MISFIT)
        return [candidates], points.select(np.flatnonzero(again[cluster]))

    def _measured(self, points: _Points, starts: I64) -> _Candidates:
        """Completed boxes of clusters, for points sorted by cluster."""
        counts = np.add.reduceat(points.weights, starts)
        rectangles = fit_rectangles(points.position[:, :2], starts)
        (top,) = quantiles_by_cluster(points.position[:, 2], starts, (TOP_SHARE,))
        by_lidar = points.weights[:, None] * (points.lidar[:, None] == np.arange(len(self._lidar_xyz)))
        lidar_share = np.add.reduceat(by_lidar, starts) / counts[:, None]
        boxes = complete_boxes(rectangles, top, lidar_share, self._lidar_xyz[:, :2], self._priors)
        long = np.maximum((rectangles.high - rectangles.low).max(1), 1e-3)
        yaw_std = np.clip(rectangles.residual_m / long, YAW_STD_MIN_RAD, YAW_STD_MAX_RAD)
        return _Candidates(boxes, self._scores(boxes, rectangles, lidar_share, counts), yaw_std, counts)

    def _scores(self, boxes: CompletedBoxes, rectangles: Rectangles, lidar_share: F64, counts: I64) -> F64:
        """(C,) in [0, 1]: how many points of those to expect, how smooth the sides, how near the size prior."""
        range_m = np.linalg.norm(boxes.center_xy[:, None] - self._lidar_xyz[:, :2], axis=2)
        per_m2 = self._config.points_per_sr * (lidar_share / np.maximum(range_m, 1e-3) ** 2).sum(1)
        full_view = counts / np.maximum(per_m2 * boxes.faces_m2, 1e-9)
        evidence = full_view / (full_view + FULL_VIEW_SHARE)
        smooth = np.exp(-rectangles.residual_m / (ROUGH_SHARE * np.sqrt(boxes.sizes[:, 0] * boxes.sizes[:, 1])))
        return np.where(boxes.class_ids >= 0, evidence * smooth * np.exp(-boxes.misfit / 4), 0.0)

    def _boxes(self, found: _Candidates, combined: CombinedCloud) -> Boxes3D:
        boxes = found.boxes
        bottom = self._ground_m(combined, boxes.center_xy)
        centers = np.concatenate([boxes.center_xy, (bottom + boxes.sizes[:, 2] / 2)[:, None]], 1)
        order = np.lexsort((centers[:, 1], centers[:, 0], -found.scores))
        order = order[(found.scores[order] >= self._config.min_score) & (boxes.class_ids[order] >= 0)]
        order = order[_unrivalled(centers[order], boxes.sizes[order], boxes.yaw_rad[order])]
        return Boxes3D(
            combined.cloud.stamp_ns,
            self._site_frame,
            centers[order],
            boxes.sizes[order],
            boxes.yaw_rad[order],
            found.scores[order].astype(np.float32),
            boxes.class_ids[order].astype(np.int32),
            found.counts[order].astype(np.int32),
            _covariances(boxes, found.yaw_std_rad)[order],
        )


def _diameter(xy: F64, starts: I64) -> F64:
    """(C,) lower bound of the diameter of each cluster: its largest extent in four directions."""
    x, y = xy.T
    half = np.sqrt(0.5)
    extents = [
        np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
        for along in (x, y, (x + y) * half, (x - y) * half)
    ]
    return np.asarray(np.max(extents, axis=0))


def _joined(found: list[_Candidates]) -> _Candidates:
    boxes = [candidates.boxes for candidates in found]
    return _Candidates(
        CompletedBoxes(*(np.concatenate([getattr(b, f.name) for b in boxes]) for f in fields(CompletedBoxes))),
        np.concatenate([candidates.scores for candidates in found]),
        np.concatenate([candidates.yaw_std_rad for candidates in found]),
        np.concatenate([candidates.counts for candidates in found]),
    )


def _turns(yaws: F64) -> F64:
    """(N, 2, 2) rotations by `yaws`."""
    cos, sin = np.cos(yaws), np.sin(yaws)
    return np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], 1)


def _unrivalled(centers: F64, sizes: F64, yaws: F64) -> I64:
    """Rows of the boxes that share little ground with a kept box before them."""
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    samples = centers[:, None, :2] + (grid * sizes[:, None, :2]) @ _turns(yaws).transpose(0, 2, 1)  # (N, G, 2)
    x, y = (samples.reshape(-1, 2) - centers[:, None, :2]).transpose(2, 0, 1)  # (N, N G): from each box's centre
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    half_length, half_width = sizes[:, :2].T[..., None] / 2
    within = (np.abs(x * cos + y * sin) <= half_length) & (np.abs(y * cos - x * sin) <= half_width)
    inside = within.reshape(len(sizes), len(sizes), len(grid)).mean(2)
    rivals = np.maximum(inside, inside.T) > OVERLAP_SHARE
    kept: list[int] = []
    for row in range(len(centers)):
        if not rivals[row, kept].any():
            kept.append(row)
    return np.array(kept, np.int64)


def _covariances(boxes: CompletedBoxes, yaw_std_rad: F64) -> F64:
    """(C, 3, 3) over x, y and yaw: independent errors along length, width and heading."""
    variance = boxes.center_std_m**2 + (SURFACE_STD_SHARE * boxes.sizes[:, 1:2]) ** 2
    turns = _turns(boxes.yaw_rad)
    covariances = np.zeros((len(variance), 3, 3))
    covariances[:, :2, :2] = turns @ (variance[:, :, None] * turns.transpose(0, 2, 1))
    covariances[:, 2, 2] = yaw_std_rad**2
    return covariances
