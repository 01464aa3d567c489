"""Camera poses that are wrong by many degrees: hardly any 2D box matches an object, so `camera_error` has no pairs.

The fit of a pose is the mean, over the 2D boxes, of the best IoU with an object of the same frame projected with that
pose. Measured on the sample recordings and on KITTI with a network: 0.52 to 0.77 as calibrated; turned by 10 degrees
or more at most 0.37 (KITTI: dense traffic, large boxes), elsewhere 0.20; with the pose of another camera at most 0.14,
with the inverse 0.08. Where the fit is poor, other poses are tried; one that fits much better shows what is wrong.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, pair_overlaps_xyxy
from lidcam.pipeline.core.geometry.rotations import matrix_of_rpy
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.found import pairs_of_images
from lidcam.run.warning import RunWarning

MIN_FRAMES = 5
"""Minimum number of frames with 2D boxes before the pose of a camera is compared with others."""

MIN_BOXES = 15
"""Minimum number of 2D boxes in these frames."""

MAX_DOUBTFUL_FIT = 0.45
"""Fit below which a pose is compared with others."""

MAX_BAD_FIT = 0.15
"""Fit below which a pose is reported even if no other pose fits."""

MIN_BETTER_FIT = 0.4
"""Minimum fit of a pose that is proposed instead."""

MIN_GAIN = 1.5
"""Minimum ratio of the fit of a proposed pose to that of the calibrated one."""

YAWS_DEG = (0, 5, -5, 10, -10, 15, -15, 20, -20, 30, -30)
"""Turns to the left that are tried, degrees; objects in an image are wide enough for such steps to find them."""

PITCHES_DEG = (0, 5, -5, 10, -10, 20, -20)
"""Turns downwards that are tried, degrees."""


class BoxFrame(NamedTuple):
    """The objects of the lidars in one frame, in the site frame, and the 2D boxes (M, 4) of a camera."""

    objects: Boxes3D
    xyxy: F32


class _Pose(NamedTuple):
    """Another pose (4, 4) of a camera, its description, and the remedy if it fits."""

    T_camera_site: F64
    description: str
    remedy: str


def coarse_pose_warning(
    camera: CameraSensor, others: Sequence[CameraSensor], frames: Sequence[BoxFrame]
) -> RunWarning | None:
    """The warning of a camera whose pose fits badly, with the pose that fits; None if it fits or too little was seen.

    Args:
        camera: As calibrated.
        others: The other cameras of the rig.
        frames: Frames with objects and with 2D boxes of the camera.
    """
    count = sum(len(frame.xyxy) for frame in frames)
    if len(frames) < MIN_FRAMES or count < MIN_BOXES:
        return None
    fit_of = _PoseFit(camera, frames)
    calibrated = fit_of(camera.T_camera_site.matrix)
    if calibrated >= MAX_DOUBTFUL_FIT:
        return None
    finding = f"its {count} boxes overlap the objects of the lidars by {calibrated:.0%} on average"
    for candidates in (_exchanged_poses(camera, others), _turned_poses(camera)):
        fit, best = max(((fit_of(pose.T_camera_site), pose) for pose in candidates), key=lambda one: one[0])
        if fit >= max(MIN_BETTER_FIT, MIN_GAIN * calibrated):
            return RunWarning(camera.name, f"{finding}, and by {fit:.0%} {best.description}", best.remedy)
    if calibrated >= MAX_BAD_FIT:
        return None
    remedy = "check its intrinsics and extrinsics; or does it look where no lidar does?"
    return RunWarning(camera.name, finding, remedy)


def _exchanged_poses(camera: CameraSensor, others: Sequence[CameraSensor]) -> Iterator[_Pose]:
    """The inverse of the camera's pose, and the poses of the other cameras."""
    yield _Pose(
        camera.T_camera_site.inverse().matrix,
        "with the inverse of its extrinsics",
        "they look inverted: T_camera_site maps points of the site to the camera, T_site_camera the other way",
    )
    remedy = "check which extrinsics, and which topics, belong to which camera"
    for other in others:
        yield _Pose(other.T_camera_site.matrix, f"with the extrinsics of {other.name}", remedy)


def _turned_poses(camera: CameraSensor) -> Iterator[_Pose]:
    """The camera's pose, turned by some degrees."""
    for yaw_deg, pitch_deg in product(YAWS_DEG, PITCHES_DEG):
        turn = np.eye(4)
        turn[:3, :3] = matrix_of_rpy(np.deg2rad([pitch_deg, yaw_deg, 0.0]))
        # What moves right and up in the image does so because the camera looks further left and down.
        sideways = [f"{abs(yaw_deg)} degrees further {'left' if yaw_deg > 0 else 'right'}"] if yaw_deg else []
        upright = [f"{abs(pitch_deg)} degrees further {'down' if pitch_deg > 0 else 'up'}"] if pitch_deg else []
        description = f"if it looked {' and '.join(sideways + upright)}"
        remedy = "calibrate it again, or see whether its clock is off (time_offset_ms in the rig file)"
        yield _Pose(turn @ camera.T_camera_site.matrix, description, remedy)


class _PoseFit:
    """The fit of poses (4, 4) of a camera to its 2D boxes."""

    def __init__(self, camera: CameraSensor, frames: Sequence[BoxFrame]) -> None:
        self._model = camera.model
        size_px = np.array([camera.model.width_px, camera.model.height_px] * 2, np.float64)
        self._boxes = np.clip(np.concatenate([frame.xyxy for frame in frames]).astype(np.float64), 0, size_px)
        objects = [frame.objects for frame in frames]
        self._corners_site = np.concatenate([box_corners(one.centers, one.sizes, one.yaws) for one in objects])
        numbers = np.arange(len(frames))
        self._rows2d, self._rows3d = pairs_of_images(
            np.repeat(numbers, [len(frame.xyxy) for frame in frames]), np.repeat(numbers, [*map(len, objects)])
        )

    def __call__(self, T_camera_site: F64) -> float:
        R, t = T_camera_site[:3, :3], T_camera_site[:3, 3]
        projected = self._model.project_boxes(np.einsum("ij,nkj->nki", R, self._corners_site) + t)
        iou, _ = pair_overlaps_xyxy(projected[self._rows3d], self._boxes[self._rows2d])
        best = np.zeros(len(self._boxes))
        np.maximum.at(best, self._rows2d, iou)
        return float(best.mean())
