"""Refinement: boxes fitted to the 2D boxes of all cameras that see them.

Position, heading and size of a matched box are estimated from its prior and the edges of its 2D boxes
(`lidcam.pipeline.fusion.refining`), with their covariance. `measured_ns` moves towards the images as far as the
position comes from them. A box without a match, or not wholly in view, stays as it is; fits that do not improve the
match, or move too far, are rejected. Underside, score and class stay.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import first_of_runs, replace_rows
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import project_edges, rounded_outline
from lidcam.pipeline.fusion.refining.box_prior import box_prior
from lidcam.pipeline.fusion.refining.edges import measured_edges
from lidcam.pipeline.fusion.refining.refinement import better_turned, refine_boxes, with_turned


class Refine:
    """Refinement of the boxes of a frame."""

    def __init__(self, rig: Rig, config: FuseConfig) -> None:
        self._lidar_xyz = rig.lidar_xyz
        self._config = config

    def __call__(
        self, hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Hypotheses:
        """The hypotheses with refined boxes; the source of those that were refined is `BOTH` or `CAMERA`.

        Args:
            hypotheses: N boxes in the site frame and their matches with `boxes2d`.
            boxes2d: By camera name.
            views: By name, the cameras at the times of their images.
        """
        if not self._config.refine:
            return hypotheses
        edges = measured_edges(hypotheses, boxes2d, views, self._config)
        boxes, edges, turned_of = with_turned(hypotheses.boxes, edges)
        placed = boxes.centers[edges.rows], boxes.sizes[edges.rows], boxes.yaws[edges.rows]
        outline = rounded_outline(placed[1], bent=edges.cameras.lenses.bends)
        in_view = project_edges(*placed, edges.cameras, outline).valid
        if not in_view.any():
            return hypotheses
        edges, outline = edges.select(in_view), outline.select(in_view)
        is_first = first_of_runs(edges.rows)
        objects = edges.rows[is_first]
        chosen, edges = boxes.select(objects), replace(edges, rows=np.cumsum(is_first) - 1)
        prior = box_prior(chosen, self._lidar_xyz, self._config)
        found = refine_boxes(chosen, prior, edges, outline)
        taken = found.accepted & better_turned(objects, found, turned_of)
        rows = turned_of[objects[taken]]
        before = hypotheses.boxes.select(rows)
        undersides_m = before.centers[:, 2] - before.sizes[:, 2] / 2
        by_camera = before.sources == Source.CAMERA.value
        refined = replace(
            before,
            centers=np.column_stack([found.centers_xy[taken], undersides_m + found.sizes[taken, 2] / 2]),
            sizes=found.sizes[taken],
            yaws=wrap_angle(found.yaws[taken]),
            covariances=found.covariances[taken],
            sources=np.where(by_camera, before.sources, np.uint8(Source.BOTH.value)),
            measured_ns=before.measured_ns + np.rint(found.later_s[taken] * 1e9).astype(np.int64),
        )
        return replace(hypotheses, boxes=replace_rows(hypotheses.boxes, rows, refined))
