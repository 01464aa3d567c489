"""Boxes completed again from their points, with another class."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import I64, Indices, replace_rows
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.completion import Directions
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter

MARGIN_SHARE = 0.5
"""Maximum distance of a box's points outside it, as a share of the link distance: a few lie outside its sides."""

MIN_POINTS = 3
"""Minimum points in a box that is fitted anew: fewer have no shape."""


class Refitter:
    """Fits boxes anew to the points in them."""

    def __init__(self, fitter: BoxFitter, config: ClusterConfig, classes: Sequence[ClassPrior]) -> None:
        self._fitter, self._config = fitter, config
        self._max_size_m = np.array([prior.max_size_m for prior in classes])

    def __call__(
        self, combined: CombinedCloud, boxes: Boxes3D, rows: Indices, directions: Directions | None = None
    ) -> tuple[Boxes3D, Indices]:
        """Boxes with new centres, sizes and yaws for some of them; and the rows of these.

        Of the two directions along its length, a new box keeps that nearer to the old one. A box stays as it is where
        too few points are in it, or where it is larger than its class can be: then it is more than one object.

        Args:
            combined: The cloud that the boxes were found in.
            boxes: Of their new classes.
            rows: The boxes to fit.
            directions: Of all boxes, if something tells them; see `BoxFitter`.
        """
        points, group = self._points_of(combined, boxes.select(rows))
        counts = np.bincount(group, minlength=len(rows))
        rows = rows[counts >= MIN_POINTS]
        points = points[counts[group] >= MIN_POINTS]
        counts = counts[counts >= MIN_POINTS]
        if not len(rows):
            return boxes, rows
        class_ids = boxes.class_ids[rows].astype(np.int64)
        known = None if directions is None else directions.of_rows(rows)
        found = self._fitter(combined, points, np.cumsum(counts) - counts, class_ids, known)
        fits = (found.sizes[:, :2] <= self._max_size_m[class_ids, :2]).all(1)
        rows = rows[fits]
        turned = np.cos(found.yaws[fits] - boxes.yaws[rows]) < 0
        fitted = replace(
            boxes.select(rows),
            centers=found.centers[fits],
            sizes=found.sizes[fits],
            yaws=wrap_angle(found.yaws[fits] + np.pi * turned),
            covariances=found.covariances[fits],
        )
        return replace_rows(boxes, rows, fitted), rows

    def _points_of(self, combined: CombinedCloud, boxes: Boxes3D) -> tuple[I64, I64]:
        """Rows of the detection cloud in each box, sorted by box, and the box of each."""
        margin_m = MARGIN_SHARE * self._config.distance_m
        rows, box = points_in_footprints(
            combined.detection_cloud.xyz, boxes.centers[:, :2], boxes.sizes[:, :2] + 2 * margin_m, boxes.yaws
        )
        place = self._fitter.above_ground(combined, rows, self._config.clearance_m).place
        rows, box = rows[place], box[place]
        top_m = boxes.centers[:, 2] + boxes.sizes[:, 2] / 2 + margin_m
        kept = combined.detection_cloud.xyz[rows, 2] <= top_m[box]
        return rows[kept], box[kept]
