"""Camera poses that are wrong by many degrees: hardly any 2D box matches an object, so `camera_error` has no pairs.

The fit of a pose is that of `BoxFit`. Measured on the sample recordings and on KITTI with a network: 0.52 to 0.77 as
calibrated; turned by 10 degrees or more at most 0.37 (KITTI: dense traffic, large boxes), elsewhere 0.20; with the pose
of another camera at most 0.14, with the inverse 0.08. Where the fit is poor, other poses are tried; one that fits much
better shows what is wrong.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.calibration.overlap import MAX_DOUBTFUL_FIT, BoxFit, BoxFrame, has_enough, turned_pose
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.readers.rig.calibration import OPTICAL_OF_BODY
from lidcam.run.warning import RunWarning

MAX_BAD_FIT = 0.15
"""Fit below which a pose is reported even if no other pose fits."""

MIN_OUTSIDE = 0.05
"""Share of boxes whose centre lies outside of the image that shows that they are of a larger one."""

MIN_BETTER_FIT = 0.4
"""Minimum fit of a pose that is proposed instead."""

MIN_GAIN = 1.5
"""Minimum ratio of the fit of a proposed pose to that of the calibrated one."""

MIN_LASTING = 0.2
"""Minimum share of boxes that lie where the image before has one; fewer are false ones, which no pose fits.

Measured in simulated rigs at 10 Hz: 0.77 to 0.94 of boxes of objects (at 2 Hz about 0.7), at most 0.25 of false ones.
"""

YAWS_DEG = (0, 5, -5, 10, -10, 15, -15, 20, -20, 30, -30)
"""Turns to the left that are tried, degrees; objects in an image are wide enough for such steps to find them."""

PITCHES_DEG = (0, 5, -5, 10, -10, 20, -20)
"""Turns downwards that are tried, degrees."""


class _Pose(NamedTuple):
    """Another pose (4, 4) of a camera, its description, and the remedy if it fits."""

    T_camera_site: F64
    description: str
    remedy: str


def coarse_pose_warning(
    camera: CameraSensor,
    others: Sequence[CameraSensor],
    frames: Sequence[BoxFrame],
    lasting: Sequence[BoxFrame],
    lidar_xyz: F64,
) -> RunWarning | None:
    """The warning of a camera whose pose fits badly, with the pose that fits; None if it fits or too little was seen.

    `lasting` are the frames with 2D boxes that lie where the image before has one, and only these boxes; `lidar_xyz`
    (L, 3) the positions of the lidars in the site frame, metres.
    """
    count = sum(len(frame.xyxy) for frame in frames)
    if not has_enough(frames):
        return None
    fit_of = BoxFit(camera.model, frames)
    calibrated = fit_of(camera.T_camera_site.matrix)
    if calibrated >= MAX_DOUBTFUL_FIT:
        return None
    finding = f"its {count} boxes overlap the objects of the lidars by {calibrated:.0%} on average"
    xyxy, size_px = np.concatenate([frame.xyxy for frame in frames]), (camera.model.width_px, camera.model.height_px)
    if ((xyxy[:, :2] + xyxy[:, 2:]) / 2 > size_px).any(1).mean() >= MIN_OUTSIDE:
        reach_px, image = " x ".join(f"{value:.0f}" for value in xyxy[:, 2:].max(0)), f"{size_px[0]} x {size_px[1]} px"
        return RunWarning(
            camera.name,
            f"{finding}, and reach to {reach_px} px where its calibration is for images of {image}",
            "record the boxes in pixels of that image, or the CameraInfo of the one that they were found in",
        )
    for candidates in (_mistaken_poses(camera, others, lidar_xyz), _turned_poses(camera)):
        fit, best = max(((fit_of(pose.T_camera_site), pose) for pose in candidates), key=lambda one: one[0])
        if fit >= max(MIN_BETTER_FIT, MIN_GAIN * calibrated):
            return RunWarning(camera.name, f"{finding}, and by {fit:.0%} {best.description}", best.remedy)
    is_judged = has_enough(lasting) and sum(len(frame.xyxy) for frame in lasting) >= MIN_LASTING * count
    if not is_judged or max(calibrated, BoxFit(camera.model, lasting)(camera.T_camera_site.matrix)) >= MAX_BAD_FIT:
        return None
    remedy = "check its intrinsics and extrinsics; or does it look where no lidar does?"
    return RunWarning(camera.name, finding, remedy)


def _mistaken_poses(camera: CameraSensor, others: Sequence[CameraSensor], lidar_xyz: F64) -> Iterator[_Pose]:
    """Poses as of mistakes: inverted, in other axes, on its side, another camera's, and beside lidars in other axes."""
    yield _Pose(
        camera.T_camera_site.inverse().matrix,
        "with the inverse of its extrinsics",
        "they look inverted: T_camera_site maps points of the site to the camera, T_site_camera the other way",
    )
    body = OPTICAL_OF_BODY @ camera.T_camera_site.matrix
    remedy = "give the pose of its optical frame: z forward, x right, y down"
    yield _Pose(body, "with its extrinsics taken as those of its body (x forward)", remedy)
    remedy = "check how its mount, or its driver, turns the image"
    for roll_deg, side in ((180, ""), (90, " counter-clockwise"), (-90, " clockwise")):
        yield _Pose(turned_pose(camera, 0, 0, roll_deg), f"if it were rolled by {abs(roll_deg)} degrees{side}", remedy)
    remedy = "check which extrinsics, and which topics, belong to which camera"
    for other in others:
        yield _Pose(other.T_camera_site.matrix, f"with the extrinsics of {other.name}", remedy)
    for yaw_deg in (90, -90, 180) if len(lidar_xyz) else ():
        turn, center = motion(np.array([0, 0, np.radians(yaw_deg), 0, 0, 0, 0])), np.append(lidar_xyz.mean(0), 0)
        turn[:, 3] += center - turn @ center
        description = f"if the lidars were turned by {yaw_deg} degrees about z"
        remedy = "check which way the x axis of the lidar points, and its extrinsics"
        yield _Pose(camera.T_camera_site.matrix @ turn, description, remedy)


def _turned_poses(camera: CameraSensor) -> Iterator[_Pose]:
    """The camera's pose, turned by some degrees."""
    for yaw_deg, pitch_deg in product(YAWS_DEG, PITCHES_DEG):
        # What moves right and up in the image does so because the camera looks further left and down.
        sideways = [f"{abs(yaw_deg)} degrees further {'left' if yaw_deg > 0 else 'right'}"] if yaw_deg else []
        upright = [f"{abs(pitch_deg)} degrees further {'down' if pitch_deg > 0 else 'up'}"] if pitch_deg else []
        description = f"if it looked {' and '.join(sideways + upright)}"
        remedy = "calibrate it again, or see whether its clock is off (time_offset_ms in the rig file)"
        yield _Pose(turned_pose(camera, yaw_deg, pitch_deg), description, remedy)
