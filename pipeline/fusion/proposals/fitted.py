"""Boxes fitted to the lidar points in the frustums of 2D boxes."""

from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.geometry.boxes import pair_overlaps_xyxy
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.protocols import Candidates3D
from lidcam.pipeline.fusion.cameras.merging import mean_places
from lidcam.pipeline.fusion.cameras.placing import Placements
from lidcam.pipeline.fusion.cameras.sightings import Sightings
from lidcam.pipeline.fusion.projection import project_edges
from lidcam.pipeline.fusion.proposals.frustums import (
    MAX_DISTANCE,
    Expected,
    FrustumPoints,
    choose_segments,
    points_in_frustums,
)

MIN_POINTS = 4
"""Minimum number of points of an object; the 2D box makes up for few points."""

DEPTH_SIGMA = 0.5
"""Standard deviation of the distance from an object's near side to its centre, as a share of it: by its heading."""

MIN_IOU = 0.3
"""Minimum IoU of an object's projected box with its 2D box."""

MAX_HEIGHT_SHARE = 1.15
"""Maximum height of a point of an object, in maximum heights of its class."""

MAX_CLEAR_SHARE = 0.8
"""Maximum share of an object's height that is expected without points."""


class FittedObjects(NamedTuple):
    """G objects."""

    sighting: I64  # (G,) int64 row of the 2D box of each, rising
    boxes: Candidates3D  # Fitted boxes, with the classes of the 2D boxes
    worth: F64  # (G,) float64 log likelihood of its points given the 2D box, up to a constant


class ObjectFitter:
    """Finds the points of the objects of 2D boxes, and fits boxes to them."""

    def __init__(self, rig: Rig, fitter: BoxFitter, config: ClusterConfig, classes: Sequence[ClassPrior]) -> None:
        self._fitter = fitter
        self._lidar_xy = rig.lidar_xyz[:, :2]
        self._config = config
        self._size = np.array([prior.size_m for prior in classes])
        self._max_height_m = np.array([prior.max_size_m[2] for prior in classes])
        # People differ little in depth, and others stand behind them
        deepest = [prior.size_m if prior.is_upright else prior.max_size_m for prior in classes]
        self._reach_m = np.hypot(*np.array(deepest).T[:2])

    def __call__(self, combined: CombinedCloud, sightings: Sightings, placements: Placements) -> FittedObjects:
        """The objects of the 2D boxes that have points; a point may belong to several objects.

        Args:
            combined: The cloud of the frame.
            sightings: S 2D boxes.
            placements: Placements of their objects.
        """
        expected = self._expected(sightings, placements)
        found, link_m = self._points(combined, sightings, expected)
        segments = choose_segments(combined.detection_cloud.xyz, found, link_m, expected, MIN_POINTS)
        rows = found.rows[segments.points]
        boxes = self._fitter(combined, rows, segments.starts, sightings.class_ids[segments.group])
        kept = _iou_with(sightings.select(segments.group), boxes) >= MIN_IOU
        return FittedObjects(
            sighting=segments.group[kept], boxes=Candidates3D(*map(itemgetter(kept), boxes)), worth=segments.worth[kept]
        )

    def _expected(self, sightings: Sightings, placements: Placements) -> Expected:
        (xy, covariances), heading = mean_places(placements), sightings.headings
        along = ((xy - sightings.origin[:, :2]) * heading).sum(1)
        variance = (heading[:, :, None] * covariances * heading[:, None, :]).sum((1, 2))
        size = self._size[sightings.class_ids]
        depth = (size[:, 0] + size[:, 1]) / 4
        range_m = np.linalg.norm(xy[:, None] - self._lidar_xy, axis=2).min(1, initial=np.inf)
        gap_m = range_m / np.sqrt(self._config.points_per_sr)
        return Expected(
            front_m=along - depth,
            front_std_m=np.sqrt(variance + (DEPTH_SIGMA * depth) ** 2),
            reach_m=self._reach_m[sightings.class_ids],
            clear_share=np.minimum(self._config.clearance_m / size[:, 2], MAX_CLEAR_SHARE),
            gap_share=gap_m / size[:, 2],
        )

    def _points(self, combined: CombinedCloud, sightings: Sightings, expected: Expected) -> tuple[FrustumPoints, F64]:
        """The points above the ground in the frustums of the 2D boxes, and their link distances."""
        margin = MAX_DISTANCE * expected.front_std_m
        min_m, max_m = np.maximum(expected.front_m - margin, 0.0), expected.front_m + margin + expected.reach_m
        found = points_in_frustums(combined.detection_cloud.xyz, sightings, min_m, max_m)
        above = self._fitter.above_ground(combined, found.rows, self._config.clearance_m)
        ceiling_m = MAX_HEIGHT_SHARE * self._max_height_m[sightings.class_ids]
        low = np.flatnonzero(above.position[:, 2] < ceiling_m[found.group[above.place]])
        return found.select(above.place[low]), above.link_distance_m[low]


def _iou_with(sightings: Sightings, boxes: Candidates3D) -> F64:
    """(G,) overlap of each projected box with its 2D box, both clipped to the image."""
    edges = project_edges(boxes.centers, boxes.sizes, boxes.yaws, sightings.views)
    clipped = edges.xyxy.clip(0, sightings.views.limits)
    iou, _ = pair_overlaps_xyxy(np.where(edges.valid[:, None], clipped, 0.0), sightings.xyxy)
    return np.where(edges.valid, iou, 0.0)
