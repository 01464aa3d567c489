"""Frames of cars that pass a camera whose pose and clock are wrong by known amounts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from detections import boxes2d, boxes3d, forward_camera, matches
from frames import frame
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.detections import Detections, Fused, Hypotheses
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.tracks import Tracks
from lidcam.pipeline.fusion.projection import Outline, cuboid_outline

CAMERA = forward_camera("cam")
CAR = (4.4, 1.8, 1.5)
START_NS, PERIOD_NS = 10**18, 10**8
EMPTY = frame()


def cuboids(_sizes: F64, *, bent: bool) -> Outline:
    """The outlines of objects that are the boxes that `passing` shows."""
    return cuboid_outline(bent=bent)


def passing(
    values: npt.ArrayLike = (0,) * 7,
    *,
    tracks: int = 8,
    frames: int = 40,
    noise: float = 1.0,
    seed: int = 0,
    speed_m_s: float = 0.0,
    camera: CameraSensor = CAMERA,
) -> list[FrameResult]:
    """Frames at 10 Hz in which lidars and a camera see cars drive to all sides."""
    random = np.random.default_rng(seed)
    start = np.stack([random.uniform(10, 35, tracks), random.uniform(-8, 8, tracks)], 1)
    yaws = random.uniform(-np.pi, np.pi, tracks)
    velocities = random.uniform(2, 9, tracks)[:, None] * np.stack([np.cos(yaws), np.sin(yaws)], 1)
    errors = np.asarray(values, np.float64)

    def seen_at(number: int) -> FrameResult:
        stamp_ns = START_NS + number * PERIOD_NS
        image_ns, measured_ns = stamp_ns + 12_000_000, stamp_ns + random.integers(-4, 4, len(start)) * 10_000_000
        # Where the rig is when the frame has its time, when the image says it was taken, and when it was.
        ahead_m, image_m = speed_m_s * (number * 0.1 - 2), speed_m_s * (number * 0.1 - 2 + 0.012)
        taken_m = image_m + speed_m_s * errors[6]
        on_ground = start + velocities * _since_s(measured_ns)
        true_xy = start + velocities * (_since_s(np.array([image_ns])) + errors[6])
        pose = pose_matrix(Rotation.from_rotvec(errors[:3]).as_matrix(), errors[3:6])
        true = Transform("cam", "site", pose @ camera.T_camera_site.matrix)
        sizes = np.tile(CAR, (len(start), 1))
        corners = box_corners(np.c_[true_xy - [taken_m, 0], np.full(len(start), -0.8)], sizes, yaws)
        xyxy = camera.model.project_boxes(true.apply(corners)).astype(np.float64)
        xyxy += noise * random.normal(0, 1.5, xyxy.shape)
        shown = np.isfinite(xyxy).all(1)
        xy = on_ground - [ahead_m, 0] + noise * random.normal(0, 0.05, start.shape)
        turned = yaws + noise * random.normal(0, 0.01, len(yaws))
        found = boxes3d(np.c_[xy, np.full(len(xy), -0.8), sizes, turned][shown], deviations=(0.07, 0.07, 0.02))
        found = replace(found, stamp_ns=stamp_ns, measured_ns=np.asarray(measured_ns[shown], np.int64))
        n = len(found)
        rows = np.arange(n)
        seen = replace(boxes2d(np.c_[xyxy[shown], np.full(n, 0.9), np.zeros(n)]), stamp_ns=image_ns)
        matched = matches(np.stack([rows, rows], 1), seen.xyxy, overlaps=0.5)
        tracked = replace(Tracks.none(n), ids=1 + np.flatnonzero(shown), velocities=velocities[shown])
        moved = pose_matrix(np.eye(3), (ahead_m - image_m, 0.0, 0.0))
        view = replace(camera, T_camera_site=camera.T_camera_site @ Transform("site", "site", moved))
        return replace(
            EMPTY,
            bundle=replace(EMPTY.bundle, index=number, stamp_ns=stamp_ns, motion=_motion(stamp_ns, speed_m_s)),
            detections=Detections(found, {"cam": seen}),
            views={"cam": view},
            hypotheses=Hypotheses(found, {"cam": matched}, n),
            fused=Fused(found, np.ones(n, np.int32), rows, tracks=tracked),
        )

    return [seen_at(number) for number in range(frames)]


def _motion(stamp_ns: int, speed_m_s: float) -> PoseSamples | None:
    if not speed_m_s:
        return None
    around_ns = np.array([stamp_ns - 10**8, stamp_ns, stamp_ns + 10**8], np.int64)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = speed_m_s * (around_ns - START_NS) * 1e-9
    return PoseSamples("site", "odom", around_ns, poses)


def without_tracks(frames: Sequence[FrameResult]) -> list[FrameResult]:
    """The same frames, of which nothing is tracked."""
    return [replace(one, fused=replace(one.fused, tracks=None)) for one in frames]


def _since_s(when_ns: I64) -> F64:
    """(N, 1) seconds since the middle of the recording."""
    return np.asarray((when_ns - START_NS) * 1e-9 - 2, np.float64).reshape(-1, 1)
