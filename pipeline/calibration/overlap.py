"""How well objects of the lidars overlap the 2D boxes in images: shows errors that leave hardly any pairs."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.core.arrays import F32, F64, I32, I64, Array, pairs_of_equal
from lidcam.pipeline.core.camera import BORDER_PX, CameraModel
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
from lidcam.pipeline.core.rig import CameraSensor

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

MIN_FIT, MIN_CHANGE_GAIN = 0.2, 1.15
"""Minimum fit after a change, and its minimum ratio to that before. A camera that fits less, both ways, is not used.

Both ways: of its 2D boxes with the objects of the lidars, and of plain objects in its view with its 2D boxes. Sound
cameras have at least 0.29 and 0.54 on KITTI and in simulation; those off by 15 degrees or more, upside down, or with
the intrinsics of another image, at most 0.15 and 0.17.
"""

SAME_PLACE_IOU = 0.5
"""Minimum IoU of 2D boxes in one place of the image."""

MIN_MATCH, MIN_MATCHES = 0.4, 8.0
"""Minimum IoU of a box that an object matches after a change, and minimum number of such boxes, in different places."""

MIN_PLAIN_SCORE, MIN_PLAIN_PX = 0.7, 24.0
"""Minimum score of an object that a camera should have found, and its minimum size in the image: the geometric mean of
width and height."""


class BoxFrame(NamedTuple):
    """The objects of the lidars in one frame, in the site frame, and the 2D boxes of a camera."""

    objects: Boxes3D
    xyxy: F32  # (M, 4)
    class_ids: I32  # (M,)


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
    if fit(change) < max(MIN_FIT, MIN_CHANGE_GAIN * fit(Change())) or matches < MIN_MATCHES:
        return camera
    yaw, pitch, roll = np.deg2rad(change[:3]).tolist()
    found = replace(camera.fit, corrected=(pitch, yaw, roll, 0.0, 0.0, 0.0, 0.0), zoom=camera.fit.zoom * change.zoom)
    return replace(camera, T_camera_site=pose, model=camera.model.zoomed(change.zoom), fit=found)


def used_if_it_fits(camera: CameraSensor, frames: Sequence[BoxFrame], unhidden: Sequence[BoxFrame]) -> CameraSensor:
    """The camera; not to be used if neither its 2D boxes nor the lidars' objects in its view have a partner.

    `unhidden` are the frames with the objects that no point hides from it.

    A camera may see what no lidar reaches, but then has boxes of what the lidars see in its view; one that sees little,
    as at night, has few boxes, which fit.
    """
    if not camera.fit.is_used or not has_enough(frames):
        return camera
    fit_of, of_unhidden = (BoxFit(camera.model, one) for one in (frames, unhidden))
    pose = camera.T_camera_site.matrix
    for best, weights in ((fit_of.best(pose), fit_of.weights()), of_unhidden.best_of_objects(pose)):
        if weights.sum() < MIN_MATCHES or np.average(best, weights=weights) >= MIN_FIT:
            return camera
    return replace(camera, fit=replace(camera.fit, is_used=False))


class BoxFit:
    """The fit of poses of a camera to its 2D boxes.

    Args:
        model: Its intrinsics.
        frames: Frames with objects and with 2D boxes of the camera.
    """

    def __init__(self, model: CameraModel, frames: Sequence[BoxFrame]) -> None:
        self._model = model
        self._size_px = np.array([model.width_px, model.height_px], np.float64)
        xyxy = np.concatenate([frame.xyxy for frame in frames]).astype(np.float64)
        self._boxes = np.clip(xyxy, 0, np.tile(self._size_px, 2))
        objects = [frame.objects for frame in frames]
        named = np.concatenate([frame.class_ids for frame in frames])
        self._is_sure = np.concatenate(
            [(one.scores >= MIN_PLAIN_SCORE) & np.isin(one.class_ids, named) for one in objects]
        )
        self._corners_site = np.concatenate([box_corners(one.centers, one.sizes, one.yaws) for one in objects])
        numbers = np.arange(len(frames))
        self._rows2d, self._rows3d = pairs_of_equal(
            np.repeat(numbers, [len(frame.xyxy) for frame in frames]), np.repeat(numbers, [*map(len, objects)])
        )

    def __call__(self, T_camera_site: F64) -> float:
        """The mean, over the 2D boxes, of the best IoU with an object of the same frame; (4, 4) pose."""
        return float(self.best(T_camera_site).mean())

    def weights(self) -> F64:
        """(M,) one over the number of 2D boxes, of all frames, in the place of each."""
        return _weights(self._boxes)

    def best(self, T_camera_site: F64, zoom: float = 1.0) -> F64:
        """(M,) best IoU of each 2D box with an object of the same frame; (4, 4) pose, factor on the focal lengths."""
        rows2d, _, iou = self._pairs(self._projected(T_camera_site, zoom))
        best = np.zeros(len(self._boxes))
        np.maximum.at(best, rows2d, iou)
        return best

    def best_of_objects(self, T_camera_site: F64) -> tuple[F64, F64]:
        """(K,) best IoU of each plain object with a 2D box of the same frame, and (K,) weights as of `weights`.

        Plain are sure ones of a class that some 2D box has, whole in the image and large enough; (4, 4) pose.
        """
        projected = self._projected(T_camera_site)
        _, rows3d, iou = self._pairs(projected)
        best = np.zeros(len(projected))
        np.maximum.at(best, rows3d, iou)
        low, high = projected[:, :2], projected[:, 2:]
        is_whole = (low > BORDER_PX).all(1) & (high < self._size_px - BORDER_PX).all(1)
        is_large = np.sqrt((high - low).prod(1)) >= MIN_PLAIN_PX
        plain = self._is_sure & is_whole & is_large
        return best[plain], _weights(projected[plain])

    def _projected(self, T_camera_site: F64, zoom: float = 1.0) -> F32:
        """(N, 4) rectangles of all objects; NaN out of view."""
        R, t = T_camera_site[:3, :3], T_camera_site[:3, 3]
        return self._model.zoomed(zoom).project_boxes(np.einsum("ij,nkj->nki", R, self._corners_site) + t)

    def _pairs(self, projected: F32) -> tuple[I64, I64, F64]:
        """(Q,) rows of 2D boxes, (Q,) rows of objects in view in the same frame, and (Q,) their IoU."""
        in_view = np.isfinite(projected[:, 0])[self._rows3d]
        rows2d, rows3d = self._rows2d[in_view], self._rows3d[in_view]
        return rows2d, rows3d, pair_overlaps_xyxy(projected[rows3d], self._boxes[rows2d])[0]


def _weights(xyxy: Array) -> F64:
    """(M,) one over the number of the boxes (M, 4) in the place of each."""
    # Box by box: a table of thousands of boxes of crowded images would take gigabytes.
    counts = [np.count_nonzero(pair_overlaps_xyxy(box, xyxy)[0] >= SAME_PLACE_IOU) for box in xyxy]
    return np.asarray(1 / np.maximum(counts, 1))
