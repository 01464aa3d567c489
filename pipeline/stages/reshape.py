"""Boxes completed again with the class that the cameras give.

A lidar sees the near sides of an object; how far it reaches behind them depends on its class. Where a camera knows the
class better, the box made with the lidars' own one is too long or too short, and its heading may be that of the other
axis: the far part of a cyclist taken for a pedestrian, or a van for a car.
"""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import F64, I64, Indices
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D, Hypotheses
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.geometry.footprints import points_in_footprints
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.core.settings.engines import ENGINES
from pipeline.detectors.cluster.fitting import BoxFitter

__all__ = ["Reshape"]


MARGIN_SHARE = 0.5
"""Points this share of the link distance outside a box belong to it: a few of them lie outside its sides."""

MIN_POINTS = 3
"""A box is left as it is where fewer points are in it: they have no shape."""


class Reshape:
    """Fits boxes anew whose class is not the one that they were completed with.

    Only boxes that were found by clustering change: a network and a recording know the shape of what they see.
    """

    def __init__(self, rig: Rig, config: Config) -> None:
        self._is_on = ENGINES[config.detect3d.method].boxes_are_completed
        self._fitter = BoxFitter(rig, config.classes, config.detect3d.cluster) if self._is_on else None
        self._max_size_m = np.array([prior.max_size_m for prior in config.classes])
        self._config = config.detect3d.cluster

    def __call__(self, combined: CombinedCloud, hypotheses: Hypotheses, lidar: Boxes3D) -> Hypotheses:
        """The same hypotheses; boxes of another class than the lidars gave them have new centres, sizes and yaws.

        Of the two directions along its length, a new box keeps that nearer to the old one. A box stays as it is where
        too few points are in it, or where it is larger than the new class can be: then it is more than one object.

        Args:
            combined: The cloud that the boxes were found in.
            hypotheses: The boxes with their class by both sensors.
            lidar: The boxes of the lidars with their own class, the first rows of the hypotheses.
        """
        boxes = hypotheses.boxes
        rows = np.flatnonzero(boxes.class_ids[: hypotheses.lidar_count] != lidar.class_ids)
        if self._fitter is None or not len(rows):
            return hypotheses
        points, group = self._points_of(combined, boxes.select(rows))
        counts = np.bincount(group, minlength=len(rows))
        rows = rows[counts >= MIN_POINTS]
        points = points[counts[group] >= MIN_POINTS]
        counts = counts[counts >= MIN_POINTS]
        if not len(rows):
            return hypotheses
        class_ids = boxes.class_ids[rows].astype(np.int64)
        found = self._fitter(combined, points, np.cumsum(counts) - counts, class_ids)
        fits = (found.sizes[:, :2] <= self._max_size_m[class_ids, :2]).all(1)
        rows = rows[fits]
        turned = np.cos(found.yaws[fits] - boxes.yaws[rows]) < 0
        reshaped = replace(
            boxes,
            centers=_with(boxes.centers, rows, found.centers[fits]),
            sizes=_with(boxes.sizes, rows, found.sizes[fits]),
            yaws=_with(boxes.yaws, rows, wrap_angle(found.yaws[fits] + np.pi * turned)),
            covariances=_with(boxes.covariances, rows, found.covariances[fits]),
        )
        return replace(hypotheses, boxes=reshaped)

    def _points_of(self, combined: CombinedCloud, boxes: Boxes3D) -> tuple[I64, I64]:
        """Rows of the detection cloud in each box, sorted by box, and the box of each."""
        assert self._fitter is not None
        margin_m = MARGIN_SHARE * self._config.distance_m
        rows, box = points_in_footprints(
            combined.detection_cloud.xyz, boxes.centers[:, :2], boxes.sizes[:, :2] + 2 * margin_m, boxes.yaws
        )
        place = self._fitter.above_ground(combined, rows, self._config.clearance_m).place
        rows, box = rows[place], box[place]
        top_m = boxes.centers[:, 2] + boxes.sizes[:, 2] / 2 + margin_m
        kept = combined.detection_cloud.xyz[rows, 2] <= top_m[box]
        return rows[kept], box[kept]


def _with(values: F64, rows: Indices, changed: F64) -> F64:
    """A copy with other values in some rows."""
    values = values.copy()
    values[rows] = changed
    return values
