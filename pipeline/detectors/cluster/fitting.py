"""Boxes fitted to groups of points: an L-shape, completed by the size prior of a class, with score and covariance."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, select_rows
from pipeline.core.clouds import CombinedCloud
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster.clusters import thin_points
from pipeline.detectors.cluster.completion import complete_boxes
from pipeline.detectors.cluster.lshape import fit_rectangles, quantiles_by_cluster
from pipeline.detectors.cluster.scores import box_covariances, box_scores
from pipeline.detectors.protocols import Candidates3D

__all__ = ["BoxFitter", "ThinnedPoints"]


THIN_SHARE = 0.2
"""Points in a cell of this share of the link distance become one: dense surfaces say no more than sparse ones."""

TOP_SHARE = 0.99
"""Share of a group's points below its top; the rest may be stray points."""

BATCH_POINTS = 1 << 16
"""Points whose groups are fitted at once: the search over headings takes kilobytes for each."""


@dataclass(frozen=True, eq=False)
class ThinnedPoints:
    """Points that each stand for the measured ones of a small cell.

    Attributes:
        position: (N, 3) x, y in the site frame and height above the ground, metres.
        link_distance_m: (N,) points nearer to each other than this belong together.
        lidar: (N,) row of `Rig.lidars` that measured the point.
        weights: (N,) number of measured points that it stands for.
        time_sum_ns: (N,) sum of their times, each minus the cloud's stamp.
    """

    position: F64
    link_distance_m: F64
    lidar: I64
    weights: I64
    time_sum_ns: I64


class BoxFitter:
    """Fits boxes to groups of points.

    Boxes stand on the ground, or where none was found at the rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud
    does not tell front from rear.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        self._lidar_xyz = np.array([lidar.T_site_lidar.translation for lidar in rig.lidars]).reshape(-1, 3)
        self._ground_height_m = rig.ground_height_m or 0.0
        self._config = config.detect3d.cluster
        self._priors = config.classes

    def __call__(self, combined: CombinedCloud, rows: I64, starts: I64, class_ids: I64) -> Candidates3D:
        """Boxes of given classes in the site frame, one for each of G groups, in their order.

        Args:
            combined: The cloud of the frame.
            rows: (P,) rows of `combined.detection_cloud`, sorted by group; a row may be in several groups.
            starts: (G,) first of `rows` of each group; each has at least one.
            class_ids: (G,) class of each group.
        """
        xyz = combined.detection_cloud.xyz[rows].astype(np.float64)
        xyz[:, 2] -= self.ground_m(combined, xyz[:, :2])
        group = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(rows)))
        points, group = self.thin(combined, rows, xyz, group)
        found, _ = self.fit(points, np.searchsorted(group, np.arange(len(starts))), class_ids)
        return self.on_ground(combined, found)

    def ground_m(self, combined: CombinedCloud, xy: F64) -> F64:
        """(N,) z of the ground at points (N, 2) of the site frame."""
        return combined.ground_m(xy, level_m=self._ground_height_m)

    def lidars_above_ground(self, combined: CombinedCloud) -> F64:
        """(L, 3) x and y of the lidars in the site frame, and their heights above the ground, metres."""
        xy = np.ascontiguousarray(self._lidar_xyz[:, :2])
        return np.column_stack([xy, self._lidar_xyz[:, 2] - self.ground_m(combined, xy)])

    def on_ground(self, combined: CombinedCloud, found: Candidates3D) -> Candidates3D:
        """Boxes whose centres are given as height above the ground, in the site frame."""
        xy = np.ascontiguousarray(found.centers[:, :2])
        return found._replace(centers=np.column_stack([xy, self.ground_m(combined, xy) + found.centers[:, 2]]))

    def thin(
        self, combined: CombinedCloud, rows: I64, position: F64, group: I64 | None = None
    ) -> tuple[ThinnedPoints, I64]:
        """Thin points, as far as their link distance allows, and say the group of each that is left.

        Points of different groups or lidars are kept apart.

        Args:
            combined: The cloud of the frame.
            rows: (N,) rows of `combined.detection_cloud`.
            position: (N, 3) x, y in the site frame and height above the ground of these.
            group: (N,) their groups, from 0; None if all are of one. The points left are sorted by it.
        """
        lidars = len(self._lidar_xyz)
        lidar = combined.detection_lidar_index[rows].astype(np.int64)
        group = np.zeros(len(rows), np.int64) if group is None else group
        gap = combined.detection_cloud.xyz[rows].astype(np.float64) - self._lidar_xyz.take(lidar, axis=0)
        range_m = np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2 + gap[:, 2] ** 2)
        link_m = self._config.distance_m + self._config.distance_per_m * range_m
        time_ns = combined.detection_cloud.time_offset_ns[rows].astype(np.int64)
        if not len(rows):
            return ThinnedPoints(position, link_m, lidar, lidar, time_ns), group
        cells = thin_points(position, link_m, THIN_SHARE, group * lidars + lidar)
        time_sum_ns = np.zeros(len(cells.counts), np.int64)
        np.add.at(time_sum_ns, cells.cell_of_point, time_ns)
        points = ThinnedPoints(cells.means, cells.distance_m, lidar[cells.first], cells.counts, time_sum_ns)
        group = group[cells.first]
        order = np.argsort(group, kind="stable")
        return select_rows(points, order), group[order]

    def fit(self, points: ThinnedPoints, starts: I64, class_ids: I64 | None = None) -> tuple[Candidates3D, F64]:
        """Boxes of G groups, whose centres are given as height above the ground, and how badly they fit their class.

        Args:
            points: Sorted by group.
            starts: (G,) first point of each group; each has at least one.
            class_ids: (G,) class of each group; if None, the class that fits best.

        Returns:
            Boxes in the order of the groups, and (G,) their `CompletedBoxes.misfit`.
        """
        given = np.full(len(starts), -1) if class_ids is None else class_ids
        ends = np.append(starts[1:], len(points.position))
        parts, misfits, first = [Candidates3D.empty()], [np.zeros(0)], 0
        while first < len(starts):
            last = max(int(np.searchsorted(ends, starts[first] + BATCH_POINTS, side="right")), first + 1)
            rows = np.arange(starts[first], ends[last - 1])
            some = select_rows(points, rows), starts[first:last] - starts[first], given[first:last]
            boxes, misfit = self._fit(*some)
            parts.append(boxes)
            misfits.append(misfit)
            first = last
        return Candidates3D(*map(np.concatenate, zip(*parts, strict=True))), np.concatenate(misfits)

    def _fit(self, points: ThinnedPoints, starts: I64, class_ids: I64) -> tuple[Candidates3D, F64]:
        """As `fit`; the class is -1 where the one that fits best is wanted."""
        counts = np.add.reduceat(points.weights, starts)
        rectangles = fit_rectangles(points.position[:, :2], starts)
        (top,) = quantiles_by_cluster(points.position[:, 2], starts, (TOP_SHARE,))
        by_lidar = points.weights[:, None] * (points.lidar[:, None] == np.arange(len(self._lidar_xyz)))
        lidar_share = np.add.reduceat(by_lidar, starts) / counts[:, None]
        boxes = complete_boxes(rectangles, top, lidar_share, self._lidar_xyz[:, :2], self._priors, class_ids)
        range_m = np.linalg.norm(boxes.center_xy[:, None] - self._lidar_xyz[:, :2], axis=2)
        expected_per_m2 = self._config.points_per_sr * (lidar_share / np.maximum(range_m, 1e-3) ** 2).sum(1)
        candidates = Candidates3D(
            np.column_stack([boxes.center_xy, boxes.sizes[:, 2] / 2]),
            boxes.sizes,
            boxes.yaw_rad,
            box_scores(boxes, rectangles, counts, expected_per_m2),
            boxes.class_ids,
            counts,
            box_covariances(boxes, rectangles, expected_per_m2),
            np.rint(np.add.reduceat(points.time_sum_ns, starts) / counts).astype(np.int64),
        )
        return candidates, boxes.misfit
