"""How each camera looks at each hypothesis: whether it could see it, and which 2D box speaks for it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Bools, check_array
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.geometry.boxes import iou_xyxy
from pipeline.core.rig import CameraSensor
from pipeline.fusion.occlusion import DepthPicture, sampled

__all__ = ["Looks", "looks_at"]


RIVAL_IOU = 0.3
"""A hypothesis whose rectangle overlaps a 2D box by this much might have been matched with it, too."""

BORDER_PX = 2.0
"""A rectangle that comes so near to the border of the image may go on beyond it."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """How C cameras look at N hypotheses; rows of cameras that did not look in this frame are not among them.

    Attributes:
        cameras: (C) names.
        in_view: (C, N) bool, whether a part of the box lies in the image.
        size_px: (C, N) float64, geometric mean of width and height of its rectangle, pixels; 0 out of view.
        visible: (C, N) float64 in [0, 1], share of it that no other object and no point hides; 0 out of view.
        is_cut: (C, N) bool, whether it reaches the border of the image.
        is_matched: (C, N) bool, whether it has a 2D box.
        scores: (C, N) float64, score of that box; 0 without one.
        iou: (C, N) float64, overlap with that box; 0 without one.
        rivals: (C, N) float64, number of other hypotheses that overlap that box, too; 0 without one.
    """

    cameras: tuple[str, ...]
    in_view: Bools
    size_px: F64
    visible: F64
    is_cut: Bools
    is_matched: Bools
    scores: F64
    iou: F64
    rivals: F64

    def __post_init__(self) -> None:
        shape = self.in_view.shape
        for name in ("size_px", "visible", "scores", "iou", "rivals"):
            check_array(name, getattr(self, name), shape, np.float64)
        for name in ("in_view", "is_cut", "is_matched"):
            check_array(name, getattr(self, name), shape, np.bool_)


def looks_at(
    hypotheses: Hypotheses,
    boxes2d: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
    combined: CombinedCloud,
) -> Looks:
    """How the cameras that have 2D boxes in this frame, or an empty list of them, look at the hypotheses.

    Args:
        hypotheses: N boxes in the site frame, and their matches.
        boxes2d: By camera name; a camera without an entry did not look.
        views: The cameras as they stood when their images were taken.
        combined: The clouds that may hide something.
    """
    boxes, cameras = hypotheses.boxes, tuple(name for name in hypotheses.matches if name in boxes2d)
    shape = len(cameras), len(boxes)
    size_px, visible, scores, iou, rivals = (np.zeros(shape) for _ in range(5))
    in_view, is_cut, is_matched = (np.zeros(shape, np.bool_) for _ in range(3))
    reach_m = np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2
    points = sampled(combined.detection_cloud.xyz) if len(boxes) else combined.detection_cloud.xyz[:0]
    for camera, name in enumerate(cameras):
        matches, found, view = hypotheses.matches[name], boxes2d[name], views[name]
        rows = np.flatnonzero(np.isfinite(matches.projected_xyxy[:, 0]))
        if len(rows):
            xyxy = matches.projected_xyxy[rows]
            in_view[camera, rows] = True
            size_px[camera, rows] = np.sqrt((xyxy[:, 2] - xyxy[:, 0]) * (xyxy[:, 3] - xyxy[:, 1]))
            border = np.array([view.model.width_px, view.model.height_px]) - BORDER_PX
            is_cut[camera, rows] = (xyxy[:, :2] <= BORDER_PX).any(1) | (xyxy[:, 2:] >= border).any(1)
            centers = np.asarray(view.T_camera_site.apply(boxes.centers[rows]))
            range_m = np.sqrt((centers * centers).sum(1)) - reach_m[rows]
            covered = DepthPicture.of(view, points).hidden(xyxy, range_m)
            visible[camera, rows] = 1 - np.maximum(covered, matches.hidden[rows])
        rows, rows2d = matches.pairs.T
        if len(rows):
            is_matched[camera, rows] = True
            scores[camera, rows] = found.scores[rows2d]
            iou[camera, rows] = matches.iou
            overlap = iou_xyxy(np.nan_to_num(matches.projected_xyxy), found.xyxy[rows2d])
            rivals[camera, rows] = np.maximum((overlap >= RIVAL_IOU).sum(0) - 1, 0)
    return Looks(cameras, in_view, size_px, visible, is_cut, is_matched, scores, iou, rivals)
