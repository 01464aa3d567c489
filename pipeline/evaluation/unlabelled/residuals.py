"""How well 3D boxes and the 2D boxes of a camera fit: projected, matched as the fusion does it, and compared."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.association import (
    class_confusion,
    class_ratios,
    detector_variances,
    fit_ratios,
    rectangle_features,
    squared_distances,
)
from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
from pipeline.core.rig import CameraSensor
from pipeline.core.settings.config import Config
from pipeline.evaluation.assignment import assign_heaviest, pairs_of_equal
from pipeline.evaluation.pieces import Pieces
from pipeline.evaluation.records import Figures

__all__ = ["Residuals"]

BLOCK_FRAMES = 64
"""Frames are compared in blocks: projecting many boxes at once takes little longer than projecting one."""

MIN_DRIFT_S = 10.0
"""In a shorter time a drift is not told from the motion of single objects."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fits:
    """Matched pairs.

    Attributes:
        stamps_ns: (K,) int64, of the frame.
        offsets_px: (K, 2) float64, centre of the 2D box minus that of the projected box.
        size_ratios: (K,) float64, of the 2D box to the projected one, of the roots of their areas.
        ious: (K,) float64.
    """

    stamps_ns: I64
    offsets_px: F64
    size_ratios: F64
    ious: F64


class Residuals:
    """The 3D boxes of one source and the 2D boxes of one camera.

    Args:
        camera: The camera.
        config: Classes, and how boxes are matched (`associate`).
    """

    def __init__(self, camera: CameraSensor, config: Config) -> None:
        self._camera, self._config = camera, config.associate
        self._class_ratios = class_ratios(class_confusion(config.classes, self._config.any_class))
        self._frames: list[tuple[int, Boxes3D, Boxes2D]] = []
        self._fits = Pieces(_Fits(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(0)))
        self._in_view = self._found = 0

    def add(self, stamp_ns: int, boxes: Boxes3D, found: Boxes2D) -> None:
        """Take in a frame in which the camera has an image.

        Raises:
            FrameError: the 3D boxes are not in the site frame of the camera.
        """
        self._frames.append((stamp_ns, boxes, found))
        if len(self._frames) == BLOCK_FRAMES:
            self._close_block()

    def figures(self) -> Figures:
        """Residuals in pixels of the camera; None where nothing is matched."""
        self._close_block()
        fits = self._fits.table()
        count = len(fits.ious)
        u, v = fits.offsets_px.T
        return {
            "matches": count,
            "boxes_3d_in_view": self._in_view,
            "boxes_2d": self._found,
            "unmatched_3d_share": 1 - count / self._in_view if self._in_view else None,
            "unmatched_2d_share": 1 - count / self._found if self._found else None,
            **_spread("offset_u", u, "_px"),
            **_spread("offset_v", v, "_px"),
            **_spread("offset_u_abs", np.abs(u), "_px"),
            **_spread("offset_v_abs", np.abs(v), "_px"),
            **_spread("size_ratio", fits.size_ratios),
            **_spread("iou", fits.ious),
            "drift_u_px_per_min": _slope(fits.stamps_ns, u),
            "drift_v_px_per_min": _slope(fits.stamps_ns, v),
        }

    def _close_block(self) -> None:
        frames, self._frames = self._frames, []
        if not frames:
            return
        boxes = [part for _, part, _ in frames]
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
        found = np.clip(np.concatenate([part.xyxy for _, _, part in frames]), 0, size)
        found_frames = np.repeat(np.arange(len(frames)), [len(part) for _, _, part in frames])
        found_class_ids = np.concatenate([part.class_ids for _, _, part in frames])
        first, second = pairs_of_equal(frame_of, found_frames)
        iou, giou = pair_overlaps_xyxy(projected[first], found[second])
        near = giou >= self._config.min_giou
        first, second, iou = first[near], second[near], iou[near]
        worth = self._worth(projected[first], found[second])
        worth += self._class_ratios[class_ids[first], found_class_ids[second]]
        allowed = worth > 0
        first, second, iou, worth = first[allowed], second[allowed], iou[allowed], worth[allowed]
        chosen = assign_heaviest(first, second, worth)
        of_3d, of_2d = projected[first[chosen]].astype(np.float64), found[second[chosen]].astype(np.float64)
        stamps_ns = np.array([stamp_ns for stamp_ns, _, _ in frames], np.int64)
        self._fits.append(
            _Fits(
                stamps_ns[frame_of[first[chosen]]],
                (of_2d[:, :2] + of_2d[:, 2:] - of_3d[:, :2] - of_3d[:, 2:]) / 2,
                np.sqrt((of_2d[:, 2:] - of_2d[:, :2]).prod(1) / (of_3d[:, 2:] - of_3d[:, :2]).prod(1)),
                iou[chosen],
            )
        )
        self._in_view += len(projected)
        self._found += len(found)

    def _worth(self, projected: F32, found: F32) -> F64:
        """(Q,) what pairs of rectangles (Q, 4) are worth by place and size; -inf beyond the gate."""
        config, model = self._config, self._camera.model
        variances = detector_variances(projected, config)
        variances[:, :2] += (np.deg2rad(config.calibration_sigma_deg) * np.diag(model.K)[:2]) ** 2
        squared = squared_distances(rectangle_features(found) - rectangle_features(projected), variances)
        area_px = np.full(len(projected), float(model.width_px * model.height_px))
        ratios = fit_ratios(squared, variances, area_px, config.unseen_boxes)
        return np.where(squared <= config.gate**2, ratios, -np.inf)


def _spread(name: str, values: F64, unit: str = "") -> dict[str, float | None]:
    some = len(values) > 0
    return {
        f"{name}_mean{unit}": float(values.mean()) if some else None,
        f"{name}_p50{unit}": float(np.percentile(values, 50)) if some else None,
        f"{name}_p90{unit}": float(np.percentile(values, 90)) if some else None,
    }


def _slope(stamps_ns: I64, values: F64) -> float | None:
    """Of the line of least squares, a minute; None over a time in which objects move more than calibrations."""
    if not len(values) or stamps_ns.max() - stamps_ns.min() < MIN_DRIFT_S * 1e9:
        return None
    minutes = (stamps_ns - stamps_ns.min()) / 6e10
    minutes -= minutes.mean()
    return float((minutes * (values - values.mean())).sum() / (minutes**2).sum())
