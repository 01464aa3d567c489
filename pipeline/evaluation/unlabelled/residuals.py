"""How well 3D boxes and the 2D boxes of a camera fit: projected, matched as the fusion does it, and compared."""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.association import (
    CALIBRATION_SIGMA_RAD,
    MAX_SIGMAS,
    MIN_GIOU,
    class_confusion,
    class_ratios,
    detector_variances,
    fit_ratios,
    rectangle_features,
    squared_distances,
)
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.assignment import assign_heaviest, pairs_of_equal
from lidcam.pipeline.evaluation.evaluation_frame import Figures

BLOCK_FRAMES = 64
"""Frames are compared in blocks: projecting many boxes at once takes little longer than projecting one."""


class Residuals:
    """The 3D boxes of one source and the 2D boxes of one camera, matched as the fusion does it."""

    def __init__(self, camera: CameraSensor, config: Config) -> None:
        self._camera = camera
        self._class_ratios = class_ratios(class_confusion(config.classes))
        self._frames: list[tuple[Boxes3D, Boxes2D]] = []
        self._offsets_px, self._ious = [np.zeros((0, 2))], [np.zeros(0)]  # of matched pairs, 2D less projected box
        self._in_view = self._found = 0

    def add(self, boxes: Boxes3D, found: Boxes2D) -> None:
        """Take in a frame in which the camera has an image.

        Raises:
            FrameError: the 3D boxes are not in the site frame of the camera.
        """
        self._frames.append((boxes, found))
        if len(self._frames) == BLOCK_FRAMES:
            self._close_block()

    def figures(self) -> Figures:
        """Residuals in pixels of the camera; None where nothing is matched."""
        self._close_block()
        ious = np.concatenate(self._ious)
        count = len(ious)
        u, v = np.concatenate(self._offsets_px).T
        return {
            "matches": count,
            "boxes_3d_in_view": self._in_view,
            "boxes_2d": self._found,
            "unmatched_3d_share": 1 - count / self._in_view if self._in_view else None,
            "unmatched_2d_share": 1 - count / self._found if self._found else None,
            "offset_u_p50_px": _percentile(u, 50),
            "offset_v_p50_px": _percentile(v, 50),
            "offset_u_abs_p90_px": _percentile(np.abs(u), 90),
            "iou_p50": _percentile(ious, 50),
        }

    def _close_block(self) -> None:
        frames, self._frames = self._frames, []
        if not frames:
            return
        boxes = [part for part, _ in frames]
        corners = box_corners(
            np.concatenate([part.centers for part in boxes]),
            np.concatenate([part.sizes for part in boxes]),
            np.concatenate([part.yaws for part in boxes]),
        )
        site = self._camera.T_camera_site.src
        frame_id = next((part.frame_id for part in boxes if len(part) and part.frame_id != site), site)
        projected = self._camera.project_boxes(corners, frame_id)
        frame_of = np.repeat(np.arange(len(frames)), [len(part) for part in boxes])
        class_ids = np.concatenate([part.class_ids for part in boxes])
        seen = ~np.isnan(projected[:, 0])
        projected, frame_of, class_ids = projected[seen], frame_of[seen], class_ids[seen]
        # Detected boxes may reach beyond the image, projections are clipped to it: clip both before comparing.
        size = np.array([self._camera.model.width_px, self._camera.model.height_px] * 2, np.float32)
        found = np.clip(np.concatenate([part.xyxy for _, part in frames]), 0, size)
        found_frames = np.repeat(np.arange(len(frames)), [len(part) for _, part in frames])
        found_class_ids = np.concatenate([part.class_ids for _, part in frames])
        first, second = pairs_of_equal(frame_of, found_frames)
        iou, giou = pair_overlaps_xyxy(projected[first], found[second])
        near = giou >= MIN_GIOU
        first, second, iou = first[near], second[near], iou[near]
        worth = self._worth(projected[first], found[second])
        worth += self._class_ratios[class_ids[first], found_class_ids[second]]
        allowed = worth > 0
        first, second, iou, worth = first[allowed], second[allowed], iou[allowed], worth[allowed]
        chosen = assign_heaviest(first, second, worth)
        of_3d, of_2d = projected[first[chosen]].astype(np.float64), found[second[chosen]].astype(np.float64)
        self._offsets_px.append((of_2d[:, :2] + of_2d[:, 2:] - of_3d[:, :2] - of_3d[:, 2:]) / 2)
        self._ious.append(iou[chosen])
        self._in_view += len(projected)
        self._found += len(found)

    def _worth(self, projected: F32, found: F32) -> F64:
        """(Q,) what pairs of rectangles (Q, 4) are worth by place and size; -inf beyond the gate."""
        model = self._camera.model
        variances = detector_variances(projected)
        variances[:, :2] += (CALIBRATION_SIGMA_RAD * np.diag(model.K)[:2]) ** 2
        squared = squared_distances(rectangle_features(found) - rectangle_features(projected), variances)
        area_px = np.full(len(projected), float(model.width_px * model.height_px))
        ratios = fit_ratios(squared, variances, area_px)
        return np.where(squared <= MAX_SIGMAS**2, ratios, -np.inf)


def _percentile(values: F64, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None
