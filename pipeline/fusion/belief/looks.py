"""How each camera looks at each hypothesis: whether it could see it, and which 2D box speaks for it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Bools, check_array
from pipeline.core.camera import BORDER_PX
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.rig import CameraSensor
from pipeline.fusion.belief.occlusion import hidden_by_points

__all__ = ["Looks", "looks_at"]


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
    """

    cameras: tuple[str, ...]
    in_view: Bools
    size_px: F64
    visible: F64
    is_cut: Bools
    is_matched: Bools
    scores: F64
    iou: F64

    def __post_init__(self) -> None:
        shape = self.in_view.shape
        for name in ("size_px", "visible", "scores", "iou"):
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
    visible, scores, iou = (np.zeros(shape) for _ in range(3))
    is_matched = np.zeros(shape, np.bool_)
    if not cameras or not len(boxes):
        nothing = np.zeros(shape, np.bool_), np.zeros(shape)
        return Looks(cameras, nothing[0], nothing[1], visible, is_matched, nothing[0].copy(), scores, iou)
    matches, models = [hypotheses.matches[name] for name in cameras], [views[name].model for name in cameras]
    projected = np.array([one.projected_xyxy for one in matches])
    in_view = np.isfinite(projected[..., 0])
    xyxy = np.where(in_view[..., None], projected, np.float32(0))
    extent = xyxy[..., 2:] - xyxy[..., :2]
    border = np.array([(model.width_px, model.height_px) for model in models], np.float32)[:, None] - BORDER_PX
    is_cut = in_view & ((xyxy[..., :2] <= BORDER_PX) | (xyxy[..., 2:] >= border)).any(2)
    pairs = in_view.nonzero()
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    covered = hidden_by_points([views[name] for name in cameras], combined.detection_cloud.xyz, corners, *pairs)
    visible[pairs] = 1 - np.maximum(covered, np.array([one.hidden for one in matches])[pairs])
    rows, found = np.concatenate([one.pairs for one in matches]).T
    camera = np.repeat(np.arange(len(cameras)), [len(one) for one in matches])
    found += np.cumsum([0, *(len(boxes2d[name]) for name in cameras)])[camera]
    is_matched[camera, rows] = True
    scores[camera, rows] = np.concatenate([boxes2d[name].scores for name in cameras])[found]
    iou[camera, rows] = np.concatenate([one.iou for one in matches])
    size_px = np.sqrt(extent.prod(2).astype(np.float64))
    return Looks(cameras, in_view, size_px, visible, is_cut, is_matched, scores, iou)
