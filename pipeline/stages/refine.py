"""Refinement: boxes fitted to the 2D boxes of all cameras that see them.

Place, heading, length and width of a matched box become what its prior and the edges of its 2D boxes say together
(`lidcam.pipeline.fusion.refining`), with the covariance of that. `measured_ns` moves towards the images as far as the
place comes from them. A box keeps what it has where no 2D box was matched with it, where it is not in view as a whole,
and where the fit explains the images no better than the box did, or takes it too far away. Height, z, score and class
stay.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import first_of_runs
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import rounded_outline
from lidcam.pipeline.fusion.refining.box_prior import box_prior
from lidcam.pipeline.fusion.refining.edges import doubted_edges, measured_edges, moved_by_borders
from lidcam.pipeline.fusion.refining.refinement import better_turned, predicted_edges, refine_boxes, with_turned


class Refine:
    """Refinement of the boxes of a frame."""

    def __init__(self, rig: Rig, config: FuseConfig) -> None:
        self._lidar_xy = np.array([lidar.T_site_lidar.translation[:2] for lidar in rig.lidars]).reshape(-1, 2)
        self._config = config

    def __call__(
        self, hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Hypotheses:
        """The hypotheses with refined boxes; the source of those that were refined is `BOTH` or `CAMERA`.

        Args:
            hypotheses: N boxes in the site frame and their matches with `boxes2d`.
            boxes2d: By camera name.
            views: The cameras where they were when they took their images, by name.
        """
        if not self._config.refine:
            return hypotheses
        edges = measured_edges(hypotheses, boxes2d, views, self._config)
        count = len(hypotheses.boxes)
        boxes, edges, turned_of = with_turned(hypotheses.boxes, edges)
        outline = rounded_outline(boxes.sizes[edges.rows], bent=edges.cameras.lenses.bends)
        predicted, jacobian, in_view = predicted_edges(boxes, edges, outline)
        if not in_view.any():
            return hypotheses
        if not in_view.all():
            edges, outline = edges.select(in_view), outline.select(in_view)
            predicted, jacobian = predicted[in_view], jacobian[in_view]
        is_own, is_first = edges.rows < count, first_of_runs(edges.rows)
        objects = edges.rows[is_first]
        chosen, edges = boxes.select(objects), replace(edges, rows=np.cumsum(is_first) - 1)
        prior = box_prior(chosen, self._lidar_xy, self._config)
        cut_px = moved_by_borders(chosen, edges.rows, edges.cameras)
        edges = doubted_edges(edges, cut_px, predicted, jacobian, prior.covariances[:, :3, :3], is_own)
        found = refine_boxes(chosen, prior, edges, outline)
        taken = found.accepted & better_turned(objects, found, turned_of)
        boxes, rows = hypotheses.boxes, turned_of[objects[taken]]
        centers, sizes, yaws = boxes.centers.copy(), boxes.sizes.copy(), boxes.yaws.copy()
        covariances, sources, measured_ns = boxes.covariances.copy(), boxes.sources.copy(), boxes.measured_ns.copy()
        centers[rows, :2], sizes[rows, :2] = found.centers_xy[taken], found.lengths_widths[taken]
        yaws[rows], covariances[rows] = wrap_angle(found.yaws[taken]), found.covariances[taken]
        sources[rows[sources[rows] != Source.CAMERA.value]] = Source.BOTH.value
        measured_ns[rows] += np.rint(found.later_s[taken] * 1e9).astype(np.int64)
        refined = replace(
            boxes,
            centers=centers,
            sizes=sizes,
            yaws=yaws,
            covariances=covariances,
            sources=sources,
            measured_ns=measured_ns,
        )
        return replace(hypotheses, boxes=refined)
