"""Association of 3D boxes with 2D boxes, for each camera on its own.

Each 3D box is projected into the image. The value of a pair is its IoU with a 2D box, less a penalty if their classes
differ. The assignment with the largest sum of values is taken (Crouse, "On implementing 2D rectangular assignment
algorithms", IEEE TAES 52(4), 2016). Pairs with too little overlap are excluded.

Depth is not used to find hidden boxes: the visible box has the larger overlap with the 2D box.
"""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.core.arrays import F32, Indices
from pipeline.core.association import worth_of_pairs
from pipeline.core.detections import Boxes2D, Boxes3D, Matches
from pipeline.core.geometry.boxes import box_corners, iou_xyxy
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.settings.config import Config

__all__ = ["Associate"]


class Associate:
    """Association of 3D boxes with the 2D boxes of a frame."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._names = [camera.name for camera in rig.cameras]
        self._config = config.associate

    def __call__(
        self, boxes3d: Boxes3D, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]
    ) -> Mapping[str, Matches]:
        """Matches by camera name, in the rig's order; a camera without an entry in `boxes2d` has no pairs.

        `views` are the cameras as they stood when the boxes were measured.

        Raises:
            FrameError: the 3D boxes are not in the site frame of the cameras.
        """
        corners = box_corners(boxes3d.centers, boxes3d.sizes, boxes3d.yaws)
        rows3d = _rank3d(boxes3d)
        matches = {}
        for camera in [views[name] for name in self._names]:
            projected = camera.project_boxes(corners, boxes3d.frame_id)
            found = boxes2d.get(camera.name, Boxes2D.empty(boxes3d.stamp_ns, camera.T_camera_site.dst))
            matches[camera.name] = self._match(camera, boxes3d, rows3d, projected, found)
        return matches

    def _match(
        self, camera: CameraSensor, boxes3d: Boxes3D, rows3d: Indices, projected: F32, boxes2d: Boxes2D
    ) -> Matches:
        # Detected boxes may reach beyond the image, projections are clipped to it: clip both before comparing.
        size = np.array([camera.model.width_px, camera.model.height_px] * 2, np.float32)
        rows2d = _rank2d(boxes2d)
        iou = iou_xyxy(projected[rows3d], np.clip(boxes2d.xyxy, 0, size)[rows2d])
        differs = boxes3d.class_ids[rows3d][:, None] != boxes2d.class_ids[rows2d]
        # Pairs that are not allowed have value 0, like no pair, and are removed from the assignment afterwards.
        worth = worth_of_pairs(iou, differs, self._config)
        first, second = linear_sum_assignment(worth, maximize=True)
        taken = worth[first, second] > 0
        first, second = first[taken], second[taken]
        pairs = np.stack([rows3d[first], rows2d[second]], 1).astype(np.int64)
        order = np.argsort(pairs[:, 0])
        hidden = np.zeros(len(boxes3d), np.float32)
        return Matches(pairs[order], iou[first, second][order].astype(np.float32), projected, hidden)


def _rank3d(boxes: Boxes3D) -> Indices:
    """Indices by falling score, then by all other fields.

    Row order decides between assignments of equal value; this one does not depend on the order of the input.
    """
    columns = [boxes.class_ids, boxes.yaws, *boxes.sizes.T, *boxes.centers.T, -boxes.scores]
    return np.lexsort(columns)


def _rank2d(boxes: Boxes2D) -> Indices:
    """Indices by falling score, then by class and position."""
    return np.lexsort([*boxes.xyxy.T, boxes.class_ids, -boxes.scores])
