"""Boxes fitted to groups of points: an L-shape, completed by the size prior of a class, with score and covariance."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, I64, Indices, Record, join_rows, select_rows
from pipeline.core.clouds import CombinedCloud, Plane
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.detectors.cluster.clusters import thin_points
from pipeline.detectors.cluster.completion import complete_boxes
from pipeline.detectors.cluster.lshape import fit_rectangles, quantiles_by_cluster, rectangles_along
from pipeline.detectors.cluster.point_kernels import points_above_ground
from pipeline.detectors.cluster.principal import principal_axes
from pipeline.detectors.cluster.scores import box_covariances, box_scores
from pipeline.detectors.protocols import Candidates3D

__all__ = ["BoxFitter", "ThinnedPoints"]


THIN_SHARE = 0.2
"""Points in a cell of this share of the link distance become one: dense surfaces say no more than sparse ones."""

TOP_SHARE = 0.99
"""Share of a group's points below its top; the rest may be stray points."""


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
        group = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(rows)))
        points, group = self.thin(combined, rows, group=group)
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
        self,
        combined: CombinedCloud,
        rows: I64,
        above_m: float = -np.inf,
        below_m: float = np.inf,
        group: I64 | None = None,
    ) -> tuple[ThinnedPoints, I64]:
        """Thin points, as far as their link distance allows, and say the group of each that is left.

        Points of different groups or lidars are kept apart.

        Args:
            combined: The cloud of the frame.
            rows: (N,) rows of `combined.detection_cloud`.
            above_m: Points are left out that are no higher than this above the ground.
            below_m: Points are left out that are at least as high.
            group: (N,) their groups, from 0; None if all are of one. The points left are sorted by it.
        """
        cloud, lidars = combined.detection_cloud, len(self._lidar_xyz)
        count, kept, position, lidar, link_m, time_ns = points_above_ground(
            cloud.xyz,
            combined.detection_lidar_index,
            cloud.time_offset_ns,
            rows,
            *ground_arrays(combined, self._ground_height_m),
            self._lidar_xyz,
            np.array([self._config.distance_m, self._config.distance_per_m]),
            np.array([above_m, below_m]),
        )
        kept, position, lidar = kept[:count], position[:count], lidar[:count]
        link_m, time_ns = link_m[:count], time_ns[:count]
        if not count:
            return ThinnedPoints(position, link_m, lidar, lidar, lidar), lidar
        cells = thin_points(position, link_m, THIN_SHARE, lidar if group is None else group[kept] * lidars + lidar)
        points = ThinnedPoints(
            cells.means,
            cells.distance_m,
            lidar[cells.first],
            cells.counts,
            np.bincount(cells.cell_of_point, time_ns).astype(np.int64),  # of whole numbers, and so exact
        )
        if group is None:
            return points, np.zeros(len(cells.first), np.int64)
        group = group[kept[cells.first]]
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
        if not len(starts):
            return Candidates3D.empty(), np.zeros(0)
        groups, lidars = len(starts), len(self._lidar_xyz)
        given = np.full(groups, -1) if class_ids is None else class_ids
        counts = np.add.reduceat(points.weights, starts)
        axis_rad, roundness = principal_axes(points.position, starts)
        rectangles = fit_rectangles(points.position, starts)
        (top,) = quantiles_by_cluster(points.position[:, 2], starts, (TOP_SHARE,))
        group = np.repeat(np.arange(groups), np.diff(starts, append=len(points.position)))
        by_lidar = np.bincount(group * lidars + points.lidar, points.weights, groups * lidars).reshape(groups, lidars)
        lidar_share = by_lidar / counts[:, None]
        lidar_xy = self._lidar_xyz[:, :2]
        boxes = complete_boxes(rectangles, top, lidar_share, lidar_xy, self._priors, given)
        riders = np.flatnonzero(boxes.rides)
        if len(riders):
            xy, first = _of_groups(points.position, starts, riders)
            along = rectangles_along(xy, first, axis_rad[riders])
            again = top[riders], lidar_share[riders], lidar_xy, self._priors, boxes.class_ids[riders]
            boxes = _with_rows(boxes, riders, complete_boxes(along, *again))
            rectangles = _with_rows(rectangles, riders, along)
        range_m = np.linalg.norm(boxes.center_xy[:, None] - self._lidar_xyz[:, :2], axis=2)
        expected_per_m2 = self._config.points_per_sr * (lidar_share / np.maximum(range_m, 1e-3) ** 2).sum(1)
        candidates = Candidates3D(
            np.column_stack([boxes.center_xy, boxes.sizes[:, 2] / 2]),
            boxes.sizes,
            boxes.yaw_rad,
            box_scores(boxes, rectangles, counts, expected_per_m2),
            boxes.class_ids,
            counts,
            box_covariances(boxes, rectangles, roundness, expected_per_m2),
            np.rint(np.add.reduceat(points.time_sum_ns, starts) / counts).astype(np.int64),
        )
        return candidates, boxes.misfit


def ground_arrays(combined: CombinedCloud, level_m: float) -> tuple[F64, F64, F64]:
    """The ground as `points_above_ground` takes it: its plane, its relief, and where the nodes of that are."""
    flat, relief = Plane(np.array([0.0, 0.0, 1.0]), -level_m), combined.relief
    plane = flat if combined.plane is None else combined.plane
    surface = np.append(plane.normal, plane.offset_m)
    if relief is None or combined.plane is None:
        return surface, np.zeros((2, 2)), np.array([0.0, 0.0, 1.0])
    return surface, relief.offsets_m, np.append(relief.origin_xy, relief.cell_m)


def _of_groups(position: F64, starts: I64, groups: Indices) -> tuple[F64, I64]:
    """The points (N, 3) of some groups, and the first of each of these."""
    counts = np.diff(starts, append=len(position))[groups]
    first = np.cumsum(counts) - counts
    return position[np.arange(counts.sum()) + np.repeat(starts[groups] - first, counts)], first


def _with_rows(record: Record, rows: Indices, changed: Record) -> Record:
    """The record with other values in some rows."""
    order = np.arange(len(next(iter(vars(record).values()))))
    order[rows] = len(order) + np.arange(len(rows))
    return select_rows(join_rows(record, changed), order)
