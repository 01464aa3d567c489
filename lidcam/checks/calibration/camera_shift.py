"""Cameras whose 2D boxes all lie beside the objects of the lidars, by the same step: their calibration is a little off.

Objects and 2D boxes still match then, each camera's boxes are only trusted less, and nobody would learn why. Of every
frame the median step of the matched pairs is taken, and of these the median over the run. Measured: a camera as
calibrated has 0.0 to 0.4 degrees on the sample recordings, on simulated drives and on KITTI with a network; more, up to
5 % of the size of its objects, where they fill much of the image. Turned by two degrees it has 1.5 to 2.7 degrees. In
three frames of KITTI and of simulated scenes, of 111 cameras as calibrated none was told, of 109 turned by two
degrees 80.
"""

from typing import NamedTuple

import numpy as np

from lidcam.checks.calibration.evenly_kept import EvenlyKept
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import BORDER_PX
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses, Matches
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.run.warning import RunWarning

MAX_FRAMES = 64
"""Frames that are kept of each camera, spread over the run."""

MIN_FRAMES, MIN_APART = 3, 0.5
"""A camera with fewer frames is not judged, nor one whose objects were never further apart in its image than this share
of their size: the box of a single parked car may be off for other reasons."""

MIN_RAD, MIN_SHARE = np.radians(1.0), 0.07
"""A step is reported if it is larger than this angle, and than this share of the size of the objects: boxes of lidars
are completed to the size of a class, and those of a detector have habits, too."""

MIN_SHARE_OF_FRAMES = 0.75
"""Share of the frames in which the step is half as large, to the same side."""

SURE = 3.0
"""The step is so many standard errors of its median, as it varies from frame to frame."""

MAX_HIDDEN = 0.3
"""Pairs of which others hide more are not compared, nor those at the border of the image."""

SIDES = (("to the left of", "to the right of"), ("above", "below"))


class _Seen(NamedTuple):
    """The pairs of one camera in one frame: (2,) median step to the right and down, and (P, 4) the 2D boxes, pixels."""

    step_px: F64
    xyxy: F64


class CameraShift:
    """Keeps how the 2D boxes of some frames lie to the objects of the lidars, and looks at the end."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = rig.cameras
        self._seen = {camera.name: EvenlyKept[_Seen](MAX_FRAMES) for camera in rig.cameras}
        sizes_px = {camera.name: np.array([camera.model.width_px, camera.model.height_px]) for camera in rig.cameras}
        self._limits_px = {name: size_px - BORDER_PX for name, size_px in sizes_px.items()}

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        for name, limit_px in self._limits_px.items():
            boxes, matches = frame.detections.cameras.get(name), frame.matches.get(name)
            if boxes is None or not matches:
                continue
            pairs = _whole_pairs(limit_px, matches, boxes, frame.hypotheses)
            if len(pairs):
                middles = (pairs[..., :2] + pairs[..., 2:]) / 2
                self._seen[name].add(_Seen(_median(middles[:, 1] - middles[:, 0]), pairs[:, 1]))

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each camera whose 2D boxes lie beside the objects."""
        found = (_warning(camera, [*self._seen[camera.name]]) for camera in self._cameras)
        return tuple(warning for warning in found if warning is not None)


def _whole_pairs(limit_px: F64, matches: Matches, boxes: Boxes2D, hypotheses: Hypotheses) -> F64:
    """(P, 2, 4) objects of the lidars, as they are projected, and their 2D boxes; in pixels, both wholly in view."""
    rows, rows2d = matches.pairs[matches.pairs[:, 0] < hypotheses.lidar_count].T
    side_by_side = np.concatenate([matches.projected_xyxy[rows], boxes.xyxy[rows2d]], 1)
    pairs = side_by_side.astype(np.float64).reshape(-1, 2, 4)
    whole = ((pairs[..., :2] > BORDER_PX) & (pairs[..., 2:] < limit_px)).all((1, 2))
    return np.asarray(pairs[whole & (matches.hidden[rows] <= MAX_HIDDEN)])


def _median(values: F64) -> F64:
    """(D,) of each column of (N, D): what numpy's gives, which takes ten times as long for a few."""
    ordered = np.sort(values, axis=0)
    return np.asarray((ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2)


def _warning(camera: CameraSensor, seen: list[_Seen]) -> RunWarning | None:
    if len(seen) < MIN_FRAMES:
        return None
    steps_px, xyxy = np.array([one.step_px for one in seen]), np.concatenate([one.xyxy for one in seen])
    step_px, size_px = np.median(steps_px, axis=0), np.median(xyxy[:, 2:] - xyxy[:, :2], axis=0)
    if (np.ptp((xyxy[:, :2] + xyxy[:, 2:]) / 2, axis=0) < MIN_APART * size_px).all():
        return None
    focal_px = np.diag(camera.model.K)[:2]
    min_px = np.maximum(MIN_RAD * focal_px, MIN_SHARE * size_px)
    error_px = 1.2533 * 1.4826 * np.median(np.abs(steps_px - step_px), axis=0) / np.sqrt(len(seen))
    frames = (steps_px * np.sign(step_px) > min_px / 2).sum(0)
    found = (np.abs(step_px) > np.maximum(min_px, SURE * error_px)) & (frames >= MIN_SHARE_OF_FRAMES * len(seen))
    if not found.any():
        return None
    parts = [
        f"{abs(step_px[axis]):.0f} px ({np.degrees(abs(step_px[axis]) / focal_px[axis]):.1f} degrees) "
        f"{SIDES[axis][int(step_px[axis] > 0)]}"
        for axis in np.flatnonzero(found)
    ]
    return RunWarning(
        camera.name,
        f"its 2D boxes lie {' and '.join(parts)} the objects of the lidars, in {frames[found].min()} of the "
        f"{len(seen)} frames looked at",
        "check its extrinsics, or see whether its clock is off (time_offset_ms in the rig file)",
    )
