"""How well objects of the lidars overlap the 2D boxes in images: shows errors that leave hardly any pairs."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
from lidcam.pipeline.core.geometry.rotations import matrix_of_rpy
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.found import pairs_of_images

MIN_FRAMES = 5
"""Minimum number of frames with 2D boxes before poses or lenses of a camera are compared."""

MIN_BOXES = 15
"""Minimum number of 2D boxes in these frames."""

LENS_TURNS_DEG = tuple(product((0, 1, -1, 2, -2, 4, -4), (0, 1, -1, 2, -2)))
"""Turns to the left and downwards with which lenses are compared, degrees: a wrong pose would favour a shorter lens."""

MIN_LENS_GAIN = 1.07
"""Minimum ratio of the fit by P to that by K.

Measured on KITTI, with poses off by up to 5 degrees: at most 1.05 for the wrong lens; 1.09 to 1.66 for the right one
against focal lengths off by 10 % or more, or a strong distortion that the images do not have.
"""


class BoxFrame(NamedTuple):
    """The objects of the lidars in one frame, in the site frame, and the 2D boxes (M, 4) of a camera."""

    objects: Boxes3D
    xyxy: F32


def has_enough(frames: Sequence[BoxFrame]) -> bool:
    """Whether frames suffice to compare poses or lenses."""
    return len(frames) >= MIN_FRAMES and sum(len(frame.xyxy) for frame in frames) >= MIN_BOXES


def turned_pose(camera: CameraSensor, yaw_deg: float, pitch_deg: float) -> F64:
    """(4, 4) T_camera_site of a camera turned to the left and downwards, degrees."""
    turn = np.eye(4)
    turn[:3, :3] = matrix_of_rpy(np.deg2rad([pitch_deg, yaw_deg, 0.0]))
    return np.asarray(turn @ camera.T_camera_site.matrix, np.float64)


def lens_that_fits(camera: CameraSensor, frames: Sequence[BoxFrame]) -> CameraSensor:
    """The camera, or `camera.rectified` if the 2D boxes clearly fit that better."""
    other = camera.rectified
    if other is None or not has_enough(frames):
        return camera
    fits = [
        max(BoxFit(one.model, frames)(turned_pose(one, *turn)) for turn in LENS_TURNS_DEG) for one in (camera, other)
    ]
    return other if fits[1] > MIN_LENS_GAIN * fits[0] else camera


class BoxFit:
    """The fit of poses of a camera to its 2D boxes.

    Args:
        model: Its intrinsics.
        frames: Frames with objects and with 2D boxes of the camera.
    """

    def __init__(self, model: CameraModel, frames: Sequence[BoxFrame]) -> None:
        self._model = model
        size_px = np.array([model.width_px, model.height_px] * 2, np.float64)
        self._boxes = np.clip(np.concatenate([frame.xyxy for frame in frames]).astype(np.float64), 0, size_px)
        objects = [frame.objects for frame in frames]
        self._corners_site = np.concatenate([box_corners(one.centers, one.sizes, one.yaws) for one in objects])
        numbers = np.arange(len(frames))
        self._rows2d, self._rows3d = pairs_of_images(
            np.repeat(numbers, [len(frame.xyxy) for frame in frames]), np.repeat(numbers, [*map(len, objects)])
        )

    def __call__(self, T_camera_site: F64) -> float:
        """The mean, over the 2D boxes, of the best IoU with an object of the same frame; (4, 4) pose."""
        R, t = T_camera_site[:3, :3], T_camera_site[:3, 3]
        projected = self._model.project_boxes(np.einsum("ij,nkj->nki", R, self._corners_site) + t)
        iou, _ = pair_overlaps_xyxy(projected[self._rows3d], self._boxes[self._rows2d])
        best = np.zeros(len(self._boxes))
        np.maximum.at(best, self._rows2d, iou)
        return float(best.mean())
