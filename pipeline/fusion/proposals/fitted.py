"""Objects that 2D boxes show, by the points of the lidars in their frustums: boxes fitted to these points."""

from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
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
    MAX_OFF,
    Expected,
    FrustumPoints,
    choose_segments,
    heading_of,
    points_in_frustums,
)
from lidcam.pipeline.fusion.proposals.parting import share_points

MIN_POINTS = 4
"""An object of fewer points is noise; the 2D box makes up for what few points do not say."""

DEPTH_STD_SHARE = 0.5
"""Standard deviation of the distance from an object's near side to its centre, as a share of it: by its heading."""

MIN_IOU = 0.3
"""Smallest IoU of an object's projected box with its 2D box."""

CEILING_SHARE = 1.15
"""Points above this multiple of the largest height of a class are none of its objects'."""

MAX_CLEAR_SHARE = 0.8
"""At least the rest of an object's height is expected to show points."""


class FittedObjects(NamedTuple):
    """G objects.

    Attributes:
        sighting: (G,) int64 row of the 2D box of each, rising.
        boxes: Fitted boxes, of the classes of the 2D boxes.
        iou: (G,) float64 overlap of the projected box with that 2D box.
        worth: (G,) float64 how well its points suit the 2D box; larger is better.
        rows: (P,) int64 rows of its points in `CombinedCloud.detection_cloud`, object after object.
        starts: (G,) int64 first of `rows` of each object.
    """

    sighting: I64
    boxes: Candidates3D
    iou: F64
    worth: F64
    rows: I64
    starts: I64


class ObjectFitter:
    """Finds the points of the objects that 2D boxes show, and fits boxes to them."""

    def __init__(self, rig: Rig, fitter: BoxFitter, config: ClusterConfig, classes: Sequence[ClassPrior]) -> None:
        self._fitter = fitter
        self._lidar_xy = np.array([lidar.T_site_lidar.translation[:2] for lidar in rig.lidars]).reshape(-1, 2)
        self._config = config
        self._size = np.array([prior.size_m for prior in classes])
        self._max_size = np.array([prior.max_size_m for prior in classes])

    def __call__(
        self, combined: CombinedCloud, sightings: Sightings, placements: Placements, owner: I64 | None = None
    ) -> FittedObjects:
        """The objects of those of the 2D boxes that have points.

        Args:
            combined: The cloud of the frame.
            sightings: S 2D boxes.
            placements: Where each of them places its object.
            owner: (S,) see `share_points`; None: a point may belong to several objects.
        """
        expected = self._expected(sightings, placements)
        found, link_m = self._points(combined, sightings, expected)
        if owner is not None:
            shared = share_points(found, owner)
            found, link_m = found.select(shared), link_m[shared]
        segments = choose_segments(combined.detection_cloud.xyz, found, link_m, expected, MIN_POINTS)
        rows = found.rows[segments.points]
        boxes = self._fitter(combined, rows, segments.starts, sightings.class_ids[segments.group])
        iou = _iou_with(sightings.select(segments.group), boxes)
        objects = FittedObjects(segments.group, boxes, iou, segments.worth, rows, segments.starts)
        return _selected(objects, iou >= MIN_IOU)

    def _expected(self, sightings: Sightings, placements: Placements) -> Expected:
        (xy, covariances), heading = mean_places(placements), heading_of(sightings)
        along = ((xy - sightings.origin[:, :2]) * heading).sum(1)
        variance = (heading[:, :, None] * covariances * heading[:, None, :]).sum((1, 2))
        size, max_size = self._size[sightings.class_ids], self._max_size[sightings.class_ids]
        depth = (size[:, 0] + size[:, 1]) / 4
        range_m = np.linalg.norm(xy[:, None] - self._lidar_xy, axis=2).min(1, initial=np.inf)
        gap_m = range_m / np.sqrt(self._config.points_per_sr)
        return Expected(
            along - depth,
            np.sqrt(variance + (DEPTH_STD_SHARE * depth) ** 2),
            np.hypot(max_size[:, 0], max_size[:, 1]),
            np.minimum(self._config.clearance_m / size[:, 2], MAX_CLEAR_SHARE),
            gap_m / size[:, 2],
        )

    def _points(self, combined: CombinedCloud, sightings: Sightings, expected: Expected) -> tuple[FrustumPoints, F64]:
        """The points above the ground in the frustums of the 2D boxes, and their link distances."""
        margin = MAX_OFF * expected.front_std_m
        nearest, furthest = np.maximum(expected.front_m - margin, 0.0), expected.front_m + margin + expected.reach_m
        found = points_in_frustums(combined.detection_cloud.xyz, sightings, nearest, furthest)
        above = self._fitter.above_ground(combined, found.rows, self._config.clearance_m)
        ceiling_m = CEILING_SHARE * self._max_size[sightings.class_ids, 2]
        low = np.flatnonzero(above.position[:, 2] < ceiling_m[found.group[above.place]])
        return found.select(above.place[low]), above.link_distance_m[low]


def _selected(objects: FittedObjects, kept: Bools) -> FittedObjects:
    """The objects of a mask."""
    counts = np.diff(objects.starts, append=len(objects.rows))
    return FittedObjects(
        objects.sighting[kept],
        Candidates3D(*map(itemgetter(kept), objects.boxes)),
        objects.iou[kept],
        objects.worth[kept],
        objects.rows[np.repeat(kept, counts)],
        np.cumsum(counts[kept]) - counts[kept],
    )


def _iou_with(sightings: Sightings, boxes: Candidates3D) -> F64:
    """(G,) overlap of each projected box with its 2D box, both clipped to the image."""
    edges = project_edges(boxes.centers, boxes.sizes, boxes.yaws, sightings.views)
    clipped = edges.xyxy.clip(0, sightings.views.limits)
    iou, _ = pair_overlaps_xyxy(np.where(edges.valid[:, None], clipped, 0.0), sightings.xyxy)
    return np.where(edges.valid, iou, 0.0)
