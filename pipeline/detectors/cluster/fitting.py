"""Boxes fitted to groups of points: an L-shape, completed by the size prior of a class, with score and covariance."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Indices, replace_rows, select_rows
from lidcam.pipeline.core.clouds import CombinedCloud, Plane
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.axes import AXIS_SIGMA_RAD, Axes
from lidcam.pipeline.detectors.cluster.clusters import thin_points
from lidcam.pipeline.detectors.cluster.completion import CompletedBoxes, Directions, Kinds, complete_boxes
from lidcam.pipeline.detectors.cluster.lshape import (
    Rectangles,
    fit_rectangles,
    principal_axes,
    quantiles_by_cluster,
    rectangles_along,
)
from lidcam.pipeline.detectors.cluster.scores import box_covariances, box_scores
from lidcam.pipeline.detectors.protocols import Candidates3D
from lidcam.pipeline.native.kernels import points_above_ground

THIN_SHARE = 0.2
"""Edge of the cells whose points become one, as a share of the link distance: dense surfaces say no more than sparse
ones."""

TOP_SHARE = 0.99
"""Share of a group's points below its top; the rest may be stray points."""

INDEPENDENT_SHARE = 0.25
"""Share of the thinned points of a side whose distances from it are independent: bodies are round, not only noisy."""

SIDE_SIGMA_M = 0.02
"""Minimum standard deviation of points about a side, metres."""

TURNS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Turns that are tried, as shares of the way from the axis that fits best to the expected one."""


@dataclass(frozen=True, eq=False)
class ThinnedPoints:
    """Points that each stand for the measured ones of a small cell."""

    position: F64  # (N, 3) x, y in the site frame and height above the ground, metres
    link_distance_m: F64  # (N,) points nearer to each other than this belong together
    lidar: I64  # (N,) row of `Rig.lidars` that measured the point
    weights: I64  # (N,) number of measured points that it stands for
    time_sum_ns: I64  # (N,) sum of their times, each minus the cloud's stamp


class AboveGround(NamedTuple):
    """P points between two heights above the ground."""

    place: I64  # (P,) rising rows of the given rows
    position: F64  # (P, 3) x, y in the site frame and height above the ground, metres
    lidar: I64  # (P,) row of `Rig.lidars` that measured the point
    link_distance_m: F64  # (P,) points nearer to each other than this belong together
    time_ns: F64  # (P,) whole numbers, minus the cloud's stamp


@dataclass(frozen=True, eq=False)
class Fitted:
    """Boxes fitted to G groups of points, above flat ground."""

    rectangles: Rectangles  # Around the points of each group
    boxes: CompletedBoxes  # These, completed
    roundness: F64  # (G,) of the points of riders, see `principal_axes`; 1 for other classes
    counts: I64  # (G,) number of measured points
    lidar_share: F64  # (G, L) share of these that each lidar measured
    time_ns: I64  # (G,) their mean time, minus the cloud's stamp


class BoxFitter:
    """Fits boxes to groups of points.

    Boxes stand on the ground, or where none was found at the rig's ground height. Yaw is in (-pi/2, pi/2]: one cloud
    does not tell front from rear.
    """

    def __init__(self, rig: Rig, classes: Sequence[ClassPrior], settings: ClusterConfig) -> None:
        self._lidar_xyz = rig.lidar_xyz
        self._ground_height_m = rig.ground_height_m or 0.0
        self._settings = settings
        self._kinds = Kinds.of(classes)

    def __call__(
        self, combined: CombinedCloud, rows: I64, starts: I64, class_ids: I64, directions: Directions | None = None
    ) -> Candidates3D:
        """Boxes of given classes in the site frame, one for each of G groups, in their order.

        Args:
            combined: The cloud of the frame.
            rows: (P,) rows of `combined.detection_cloud`, sorted by group; a row may be in several groups.
            starts: (G,) first of `rows` of each group; each has at least one.
            class_ids: (G,) class of each group.
            directions: If something tells them: an axis that fits nearly as well is taken, and which side is the
                length is decided with the sizes.
        """
        group = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(rows)))
        points, group = self.thin(combined, rows, group=group)
        if not len(starts):
            return Candidates3D.empty()
        starts = np.searchsorted(group, np.arange(len(starts)))
        return self.candidates(combined, self.fit(points, starts, class_ids, directions))

    def ground_m(self, combined: CombinedCloud, xy: F64) -> F64:
        """(N,) z of the ground at points (N, 2) of the site frame."""
        return combined.ground_m(xy, level_m=self._ground_height_m)

    def lidars_above_ground(self, combined: CombinedCloud) -> F64:
        """(L, 3) x and y of the lidars in the site frame, and their heights above the ground, metres."""
        xy = np.ascontiguousarray(self._lidar_xyz[:, :2])
        return np.column_stack([xy, self._lidar_xyz[:, 2] - self.ground_m(combined, xy)])

    def above_ground(self, combined: CombinedCloud, rows: I64, above_m: float, below_m: float = np.inf) -> AboveGround:
        """The points of rows (N,) of `combined.detection_cloud` between two heights above the ground, both excluded."""
        found = points_above_ground(
            combined.detection_cloud.xyz,
            combined.detection_lidar_index,
            combined.detection_cloud.time_offset_ns,
            rows,
            *_ground_arrays(combined, self._ground_height_m),
            self._lidar_xyz,
            self._settings.distance_m,
            self._settings.distance_per_m,
            above_m,
            below_m,
        )
        return AboveGround(*found)

    def thin(
        self,
        combined: CombinedCloud,
        rows: I64,
        above_m: float = -np.inf,
        below_m: float = np.inf,
        group: I64 | None = None,
    ) -> tuple[ThinnedPoints, I64]:
        """Thin points, as `above_ground` takes them, as far as their link distance allows; and the group of each left.

        Points of different groups (N,), from 0, or lidars are kept apart; the points left are sorted by group.
        """
        kept, position, lidar, link_m, time_ns = self.above_ground(combined, rows, above_m, below_m)
        if not len(kept):
            return ThinnedPoints(position, link_m, lidar, lidar, lidar), lidar
        own = lidar if group is None else group[kept] * len(self._lidar_xyz) + lidar
        cells = thin_points(position, link_m, THIN_SHARE, own)
        points = ThinnedPoints(
            position=cells.means,
            link_distance_m=cells.distance_m,
            lidar=lidar[cells.first],
            weights=cells.counts,
            time_sum_ns=np.bincount(cells.cell_of_point, time_ns).astype(np.int64),  # of whole numbers, and so exact
        )
        if group is None:
            return points, np.zeros(len(cells.first), np.int64)
        group = group[kept[cells.first]]
        order = np.argsort(group, kind="stable")
        return select_rows(points, order), group[order]

    def fit(
        self, points: ThinnedPoints, starts: I64, class_ids: I64 | None = None, directions: Directions | None = None
    ) -> Fitted:
        """Boxes fitted to G groups, at least one.

        Args:
            points: Sorted by group.
            starts: (G,) first point of each group; each has at least one.
            class_ids: (G,) class of each group; if None, the class that fits best.
            directions: See `__call__`.
        """
        lidar_xy = np.ascontiguousarray(self._lidar_xyz[:, :2])
        counts, lidars = np.add.reduceat(points.weights, starts), len(lidar_xy)
        of_lidar = lidars * np.repeat(np.arange(len(starts)), np.diff(starts, append=len(points.lidar))) + points.lidar
        by_lidar = np.bincount(of_lidar, points.weights, lidars * len(starts)).reshape(-1, lidars)
        lidar_share = by_lidar / counts[:, None]
        time_ns = np.rint(np.add.reduceat(points.time_sum_ns, starts) / counts).astype(np.int64)
        rectangles = fit_rectangles(points.position, starts)
        if directions is not None:
            rectangles = _along_axes(rectangles, points.position, starts, directions.axes)
        top_m = quantiles_by_cluster(points.position[:, 2], starts, TOP_SHARE)
        gap_m = _widest_gaps(points.position[:, 2], starts)
        boxes = complete_boxes(rectangles, top_m, gap_m, lidar_share, lidar_xy, self._kinds, class_ids, directions)
        roundness, riders = np.ones(len(starts)), np.flatnonzero(boxes.rides)
        if len(riders):
            rows, first = rows_of(starts, len(points.position), boxes.rides)
            xy = points.position[rows]
            axis_rad, roundness[riders] = principal_axes(xy, first)
            along = rectangles_along(xy, first, axis_rad)
            again = top_m[riders], gap_m[riders], lidar_share[riders], lidar_xy, self._kinds, boxes.class_ids[riders]
            of_riders = None if directions is None else directions.of_rows(riders)
            boxes = replace_rows(boxes, riders, complete_boxes(along, *again, of_riders))
            rectangles = replace_rows(rectangles, riders, along)
        return Fitted(rectangles, boxes, roundness, counts, lidar_share, time_ns)

    def candidates(self, combined: CombinedCloud, fitted: Fitted) -> Candidates3D:
        """Fitted boxes in the site frame, with what speaks for them and how well they are known."""
        boxes, rectangles = fitted.boxes, fitted.rectangles
        range_m = np.linalg.norm(boxes.center_xy[:, None] - self._lidar_xyz[:, :2], axis=2)
        per_m2 = self._settings.points_per_sr * (fitted.lidar_share / np.maximum(range_m, 1e-3) ** 2).sum(1)
        z = self.ground_m(combined, boxes.center_xy) + boxes.sizes[:, 2] / 2
        return Candidates3D(
            centers=np.concatenate([boxes.center_xy, z[:, None]], 1),
            sizes=boxes.sizes,
            yaws=boxes.yaw_rad,
            scores=box_scores(boxes, rectangles, fitted.counts, per_m2),
            class_ids=boxes.class_ids,
            point_counts=fitted.counts,
            covariances=box_covariances(boxes, rectangles, fitted.roundness, per_m2),
            time_offsets_ns=fitted.time_ns,
        )


def _along_axes(rectangles: Rectangles, xy: F64, starts: I64, axes: Axes) -> Rectangles:
    """The likeliest rectangles on the way to the axes, by these and the distances of the points from the sides.

    The noise of the points is unknown, so a likelihood ratio is a power of the ratio of the mean squared distances.
    """
    counts = INDEPENDENT_SHARE * np.diff(starts, append=len(xy))
    away_rad = wrap_angle(4 * (axes.angles_rad - rectangles.angle_rad)) / 4
    best, least = rectangles, np.full(len(starts), np.inf)
    for share in TURNS:
        tried = rectangles_along(xy, starts, rectangles.angle_rad + share * away_rad) if share else rectangles
        fit = counts / 2 * np.log(tried.residual_m**2 + SIDE_SIGMA_M**2)
        cost = fit - np.maximum(axes.log_odds - ((1 - share) * away_rad / AXIS_SIGMA_RAD) ** 2 / 2, 0.0)
        better = np.flatnonzero(cost < least)
        best, least = replace_rows(best, better, select_rows(tried, better)), np.minimum(least, cost)
    return best


def _ground_arrays(combined: CombinedCloud, level_m: float) -> tuple[F64, F64, F64]:
    """The ground as `points_above_ground` takes it: its plane, its relief, and where the nodes of that are."""
    flat, relief = Plane(np.array([0.0, 0.0, 1.0]), -level_m), combined.relief
    plane = flat if combined.plane is None else combined.plane
    surface = np.append(plane.normal, plane.offset_m)
    if relief is None or combined.plane is None:
        return surface, np.zeros((2, 2)), np.array([0.0, 0.0, 1.0])
    return surface, relief.offsets_m, np.append(relief.origin_xy, relief.cell_m)


def rows_of(starts: I64, count: int, is_wanted: Bools) -> tuple[Indices, I64]:
    """The rows of the wanted ones of G groups; and where each of these begins.

    Args:
        starts: (G,) first row of each group; rows are sorted by group.
        count: Number of rows.
        is_wanted: (G,)
    """
    counts = np.diff(starts, append=count)
    taken = counts[is_wanted]
    return np.repeat(is_wanted, counts).nonzero()[0], np.cumsum(taken) - taken


def _widest_gaps(heights_m: F64, starts: I64) -> F64:
    """(G,) the widest gap between the heights of the points of each group, metres: 0 of a single one."""
    group = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(heights_m)))
    apart_m = np.ptp(heights_m) + 1.0  # Groups above each other: plain numbers are sorted five times as fast as rows
    steps_m = np.diff(np.sort(heights_m + group * apart_m), prepend=0.0)
    steps_m[starts] = 0.0
    return np.asarray(np.maximum.reduceat(steps_m, starts))
