"""The part of the site in which truth is labelled, where that is what one camera sees.

Data sets such as KITTI label what a camera sees, while their clouds are full circles. Boxes outside of that view, and
beyond the farthest label, are neither right nor false.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.rotated_iou import OrientedBoxes
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, EvaluationFrame
from lidcam.pipeline.evaluation.scales import ranges_m

MIN_OBJECTS = 8
"""Smallest number of different true objects that shows where truth is labelled: a few may stay together by chance."""

MAX_CHANCE = 1e-3
"""Largest probability that all true objects are in one view although they are spread as the boxes of the lidars are."""

MIN_LEVEL = 0.5
"""Smallest share of the optical axis along the ground at which a view is a sector as seen from above."""


class LabelledPart(NamedTuple):
    """The part in which truth is labelled."""

    camera: str  # Name of the camera that sees it
    region: list[list[float]]  # Corners x, y of its view from above, metres in the site frame
    max_range_m: float  # Distance of the farthest true object from the origin of the site frame, rounded up


class LabelledPartSearch:
    """Looks for a camera that sees all true objects; keeps a few bytes of each box of the lidars."""

    def __init__(self, cameras: Sequence[CameraSensor]) -> None:
        self._cameras = [one for one in cameras if np.hypot(*one.T_camera_site.matrix[2, :2]) >= MIN_LEVEL]
        self._seen: dict[str, list[Bools]] = {camera.name: [] for camera in cameras}
        self._ranges_m = [np.zeros(0)]
        self._tracks: set[int] = set()
        self._most, self._range_m = 0, 0.0  # true objects in one frame, and how far they are at most

    def add_frame(self, frame: EvaluationFrame) -> bool:
        """Take in one frame; returns whether a camera is left that sees all true objects so far."""
        truth, lidar = frame.truth, frame.sources.get("lidar")
        if truth is not None and lidar is not None and len(truth):
            self._cameras = [camera for camera in self._cameras if _is_seen(truth, camera).all()]
            for camera in self._cameras:
                self._seen[camera.name].append(_is_seen(lidar.boxes, camera))
            self._ranges_m.append(ranges_m(lidar.boxes.centers))
            self._tracks.update(truth.track_ids[truth.track_ids != UNKNOWN].tolist())
            self._most = max(self._most, len(truth))
            self._range_m = max(self._range_m, float(ranges_m(truth.centers).max()))
        return bool(self._cameras)

    def found(self) -> LabelledPart | None:
        """The part; None where truth may be labelled all round.

        There have to be boxes of the lidars outside of the view, and so many true objects that chance does not explain
        why none of them is there. Without ids, they are as many as in the frame that has most.
        """
        objects = max(len(self._tracks), self._most)
        near = np.concatenate(self._ranges_m) <= self._range_m
        if not self._cameras or objects < MIN_OBJECTS or not near.any():
            return None
        shares = [float(np.concatenate(self._seen[camera.name])[near].mean()) for camera in self._cameras]
        if min(shares) ** objects > MAX_CHANCE:
            return None
        camera = self._cameras[shares.index(min(shares))]
        return LabelledPart(camera.name, _view_from_above(camera, self._range_m), float(np.ceil(self._range_m)))


def _view_from_above(camera: CameraSensor, range_m: float) -> list[list[float]]:
    """Corners of a sector from the camera to beyond `range_m`; without what distortion adds at the border."""
    T, K = camera.T_camera_site.inverse(), camera.model.K
    across = (np.array([0, camera.model.width_px / 2, camera.model.width_px]) - K[0, 2]) / K[0, 0]
    rays = np.column_stack([across, np.zeros(3), np.ones(3)]) @ T.matrix[:2, :3].T
    ends = T.translation[:2] + 2 * (range_m + np.hypot(*T.translation[:2])) * rays / np.hypot(*rays.T)[:, None]
    return [[round(x, 2), round(y, 2)] for x, y in [T.translation[:2].tolist(), *ends.tolist()]]


def _is_seen(boxes: OrientedBoxes, camera: CameraSensor) -> Bools:
    """(N,) whether a part of each box is in the image."""
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    return np.asarray(np.isfinite(camera.model.project_boxes(camera.T_camera_site.apply(corners))).all(1))
