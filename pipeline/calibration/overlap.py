"""How well objects of the lidars overlap the 2D boxes in images: shows errors that leave hardly any pairs."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
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


class Change(NamedTuple):
    """A change of a camera's pose or lens."""

    yaw_deg: float = 0.0  # To the left
    pitch_deg: float = 0.0  # Downwards
    roll_deg: float = 0.0  # Counter-clockwise, as the camera looks
    zoom: float = 1.0  # Factor on the focal lengths


CAUSES = (
    tuple(Change(yaw_deg, pitch_deg) for yaw_deg in range(-8, 9, 2) for pitch_deg in range(-6, 7, 2)),
    tuple(Change(roll_deg=roll_deg) for roll_deg in range(-8, 9, 2)),
    tuple(Change(zoom=zoom / 20) for zoom in range(14, 29)),
)
"""Changes that are tried; a camera has one of these errors. Objects are wide enough for such steps."""

FINE_DEG = (0, 1, -1)
"""Turns that are tried about the best of them, degrees."""

MIN_TURN_DEG = 2.0
"""Minimum turn by which a camera is corrected; pairs of boxes show smaller ones better."""

MIN_ZOOM = 0.07
"""Minimum change of the focal lengths by which a camera is corrected: the boxes hardly tell smaller ones apart."""

MAX_DOUBTFUL_FIT = 0.45
"""Fit below which a pose is compared with others: rigs without errors have more in simulation, and less in dense
traffic, where cameras see further than lidars."""

MIN_CHANGED_FIT, MIN_CHANGE_GAIN = 0.2, 1.15
"""Minimum fit after a change, and its minimum ratio to that before."""

SAME_PLACE_IOU = 0.5
"""Minimum IoU of 2D boxes in one place of the image."""

MIN_MATCH, MIN_MATCHES = 0.4, 8.0
"""Minimum IoU of a box that an object matches after a change, and minimum number of such boxes, in different places."""


class BoxFrame(NamedTuple):
    """The objects of the lidars in one frame, in the site frame, and the 2D boxes (M, 4) of a camera."""

    objects: Boxes3D
    xyxy: F32


def has_enough(frames: Sequence[BoxFrame]) -> bool:
    """Whether frames suffice to compare poses or lenses."""
    return len(frames) >= MIN_FRAMES and sum(len(frame.xyxy) for frame in frames) >= MIN_BOXES


def turned_pose(camera: CameraSensor, yaw_deg: float, pitch_deg: float, roll_deg: float = 0.0) -> F64:
    """(4, 4) T_camera_site of a camera turned to the left, downwards and counter-clockwise, degrees."""
    turn = motion(np.array([*np.deg2rad([pitch_deg, yaw_deg, roll_deg]), 0.0, 0.0, 0.0]))
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


def camera_that_fits(camera: CameraSensor, frames: Sequence[BoxFrame]) -> CameraSensor:
    """The camera, or the same turned by degrees, or with another focal length, if the 2D boxes clearly fit that better.

    These are errors of poses measured by hand and of intrinsics of another lens. Boxes of one place in the image, as
    those of a parked car, count as one. `fit` has the change. A camera that was turned before stays.
    """
    if any(camera.fit.corrected) or not has_enough(frames):
        return camera
    fit_of = BoxFit(camera.model, frames)
    if fit_of(camera.T_camera_site.matrix) >= MAX_DOUBTFUL_FIT:
        return camera
    weights = fit_of.weights()

    @cache
    def fit(change: Change) -> float:
        return float(np.average(fit_of.best(turned_pose(camera, *change[:3]), change.zoom), weights=weights))

    change = max((max(cause, key=fit) for cause in CAUSES), key=fit)
    yaws, pitches, rolls = (
        FINE_DEG if is_tried else (0,) for is_tried in (any(change[:2]), any(change[:2]), change[2])
    )
    fine = (
        Change(change.yaw_deg + yaw, change.pitch_deg + pitch, change.roll_deg + roll, change.zoom)
        for yaw, pitch, roll in product(yaws, pitches, rolls)
    )
    change = max(fine, key=fit)
    if np.linalg.norm(change[:3]) < MIN_TURN_DEG and abs(change.zoom - 1) < MIN_ZOOM:
        return camera
    pose = replace(camera.T_camera_site, matrix=turned_pose(camera, *change[:3]))
    matches = weights[fit_of.best(pose.matrix, change.zoom) >= MIN_MATCH].sum()
    if fit(change) < max(MIN_CHANGED_FIT, MIN_CHANGE_GAIN * fit(Change())) or matches < MIN_MATCHES:
        return camera
    yaw, pitch, roll = np.deg2rad(change[:3]).tolist()
    found = replace(camera.fit, corrected=(pitch, yaw, roll, 0.0, 0.0, 0.0, 0.0), zoom=camera.fit.zoom * change.zoom)
    return replace(camera, T_camera_site=pose, model=camera.model.zoomed(change.zoom), fit=found)


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
        return float(self.best(T_camera_site).mean())

    def weights(self) -> F64:
        """(M,) one over the number of 2D boxes, of all frames, in the place of each."""
        # Box by box: a table of thousands of boxes of crowded images would take gigabytes.
        counts = [(pair_overlaps_xyxy(box, self._boxes)[0] >= SAME_PLACE_IOU).sum() for box in self._boxes]
        return np.asarray(1 / np.maximum(counts, 1))

    def best(self, T_camera_site: F64, zoom: float = 1.0) -> F64:
        """(M,) best IoU of each 2D box with an object of the same frame; (4, 4) pose, factor on the focal lengths."""
        R, t = T_camera_site[:3, :3], T_camera_site[:3, 3]
        projected = self._model.zoomed(zoom).project_boxes(np.einsum("ij,nkj->nki", R, self._corners_site) + t)
        in_view = np.isfinite(projected).all(1)[self._rows3d]
        rows2d, rows3d = self._rows2d[in_view], self._rows3d[in_view]
        best = np.zeros(len(self._boxes))
        np.maximum.at(best, rows2d, pair_overlaps_xyxy(projected[rows3d], self._boxes[rows2d])[0])
        return best
