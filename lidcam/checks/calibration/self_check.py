"""Small errors of poses and clocks, found from what a run saw: of cameras against the lidars, and between lidars.

A camera is judged by 2D boxes and the boxes of the lidars that tracks move to the time of its image, a lidar by the
surfaces that it sees and another sees, too. An error is told if it is sure and large enough to matter: recordings
without any show a little of everything.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from lidcam.checks.calibration.evenly_kept import EvenlyKept
from lidcam.checks.calibration.judged import CameraJudged, LidarsJudged, camera_warning, lidars_warning
from lidcam.pipeline.calibration.camera_error import camera_error
from lidcam.pipeline.calibration.lidar_error import LidarError, lidar_error
from lidcam.pipeline.calibration.motions import motion
from lidcam.pipeline.calibration.pairs import TrackedPairs, tracked_pairs
from lidcam.pipeline.core.arrays import F64, Bools, join_rows
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.run.warning import RunWarning

MAX_FRAMES, MAX_CLOUDS = 400, 2
"""Frames of which the pairs of a camera are kept, and whose clouds are, spread over the run."""

SURE = 4.0
"""An error is told if it is so many standard deviations from none,"""

LEAST_CAMERA = np.array([np.radians(0.3), np.radians(0.3), np.radians(0.5), 0.07, 0.07, 0.07, 0.015])
"""and larger than this: radians, shares of the size of the objects (0.2 m among cars), seconds."""

LEAST_LIDAR = np.array([*np.radians([0.3, 0.3, 0.3]), 0.03, 0.03, 0.03])
"""And of a lidar: radians, metres."""

STILL_PER_S = 0.1
"""What moves by less than this share of its length in a second stands still."""

MARGIN = 1.3
"""Points in boxes so many times as long and wide belong to what moves."""


class _Clouds(NamedTuple):
    combined: CombinedCloud
    moving: Boxes3D


class SelfCheck:
    """Gathers what says something of the rig over a run, and judges it at the end."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._rig, self._config = rig, config
        self._pairs = {camera.name: EvenlyKept[TrackedPairs](MAX_FRAMES) for camera in rig.cameras}
        self._clouds = EvenlyKept[_Clouds](MAX_CLOUDS)

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        for name, pairs in tracked_pairs(frame):
            self._pairs[name].add(pairs)
        if len(self._rig.lidars) > 1 and len(frame.combined.points_by_lidar) == len(self._rig.lidars):
            self._clouds.add(_Clouds(frame.combined, _moving(frame)))

    @cached_property
    def cameras(self) -> tuple[CameraJudged, ...]:
        """What is said of each camera; to be asked when all frames are there."""
        return tuple(self._camera_judged(camera) for camera in self._rig.cameras)

    def _camera_judged(self, camera: CameraSensor) -> CameraJudged:
        """Judge a camera; what is told of it is found once more with nothing else wrong: it has one cause."""
        lidar_xy = np.array([lidar.T_site_lidar.translation[:2] for lidar in self._rig.lidars]).reshape(-1, 2)
        frames, fuse, wrong = [*self._pairs[camera.name]], self._config.fuse, np.zeros(7, np.bool_)
        if not frames:
            return CameraJudged(camera, 0, 0, None, wrong)
        pairs = join_rows(*frames)
        error = camera_error(pairs, camera, lidar_xy, fuse)
        if error is not None:
            wrong = _told(error.values, error.sigmas, LEAST_CAMERA * error.units)
            if wrong.any():
                error = camera_error(pairs, camera, lidar_xy, fuse, free=wrong) or error
        return CameraJudged(camera, len(pairs), len(np.unique(pairs.tracks)), error, wrong)

    @cached_property
    def lidars(self) -> tuple[LidarsJudged, ...]:
        """What is said of each two lidars; to be asked when all frames are there.

        Of three lidars and more, the one that disagrees with several is the one that is wrong: it is the second.
        """
        lidars = range(len(self._rig.lidars))
        clouds = [_of_lidars(kept, len(lidars)) for kept in self._clouds] if len(lidars) > 1 else []
        found = {pair: self._lidars_judged(clouds, *pair) for pair in combinations(lidars, 2)}
        wrong = [pair for pair, judged in found.items() if judged.wrong.any()]
        for row in {*lidars}.intersection(*wrong) if len(wrong) > 1 else ():
            for pair in [pair for pair in wrong if pair[0] == row]:
                found[pair] = self._lidars_judged(clouds, pair[1], row)
        return tuple(found.values())

    def _lidars_judged(self, clouds: Sequence[Sequence[F64]], first: int, second: int) -> LidarsJudged:
        lidars, frames = self._rig.lidars, [(by_lidar[first], by_lidar[second]) for by_lidar in clouds]
        error = lidar_error(frames, lidars[second].T_site_lidar.translation)
        wrong = np.zeros(6, np.bool_) if error is None else _told(error.values, error.sigmas, LEAST_LIDAR)
        return LidarsJudged(lidars[first], lidars[second], error, wrong)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each camera, and for each two lidars, whose error is told."""
        cameras = (camera_warning(judged) for judged in self.cameras if judged.wrong.any())
        lidars = (lidars_warning(judged) for judged in self.lidars if judged.wrong.any())
        return (*lidars, *cameras)

    def corrected(self) -> Rig:
        """The rig with every error taken off that is told; of two lidars that disagree, the second is moved."""
        cameras = tuple(_corrected_camera(judged) for judged in self.cameras)
        lidars = {lidar.name: lidar for lidar in self._rig.lidars}
        for judged in self.lidars:
            if judged.error is not None and judged.wrong.any() and lidars[judged.second.name] is judged.second:
                lidars[judged.second.name] = _corrected_lidar(judged.second, judged.error)
        return replace(self._rig, cameras=cameras, lidars=tuple(lidars.values()))


def _told(values: F64, sigmas: F64, least: F64) -> Bools:
    return np.asarray((np.abs(values) > SURE * sigmas) & (np.abs(values) > least))


def _corrected_camera(judged: CameraJudged) -> CameraSensor:
    camera, error = judged.camera, judged.error
    if error is None or not judged.wrong.any():
        return camera
    T_camera_site = camera.T_camera_site
    pose = replace(T_camera_site, matrix=motion(error.values) @ T_camera_site.matrix)
    # Stamps are later than the images by the offset: images taken later than was thought have a smaller one.
    offset_ns = camera.time_offset_ns - round(float(error.values[6]) * 1e9)
    return replace(camera, T_camera_site=pose, time_offset_ns=offset_ns)


def _corrected_lidar(lidar: LidarSensor, error: LidarError) -> LidarSensor:
    matrix, step = lidar.T_site_lidar.matrix.copy(), motion(error.values)
    matrix[:3, :3] = step[:3, :3] @ matrix[:3, :3]
    matrix[:3, 3] += step[:3, 3]
    return replace(lidar, T_site_lidar=replace(lidar.T_site_lidar, matrix=matrix))


def _moving(frame: FrameResult) -> Boxes3D:
    """The objects of a frame that do not stand still, or of which that is not known."""
    objects, tracks = frame.fused.objects, frame.fused.tracks
    if tracks is None:
        return objects
    return objects.select(~((tracks.ids != NO_TRACK) & (tracks.speeds < STILL_PER_S * objects.sizes[:, 0])))


def _of_lidars(kept: _Clouds, count: int) -> list[F64]:
    """The points (N, 3) of each lidar in the site frame, without what moves."""
    combined, moving = kept
    parts = [(combined.detection_cloud.xyz, combined.detection_lidar_index)]
    if combined.ground_lidar_index is not None:
        parts.append((combined.ground_cloud.xyz, combined.ground_lidar_index))
    xyz, index = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    inside, _ = points_in_footprints(xyz, moving.centers[:, :2], moving.sizes[:, :2] * MARGIN, moving.yaws)
    stands = np.ones(len(xyz), np.bool_)
    stands[inside] = False
    return [xyz[stands & (index == lidar)].astype(np.float64) for lidar in range(count)]
