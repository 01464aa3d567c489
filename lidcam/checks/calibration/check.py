"""Warnings of calibration that cannot be right."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from lidcam.checks.calibration.camera_fit import CameraFit
from lidcam.checks.calibration.camera_points import CameraPoints
from lidcam.checks.calibration.camera_shift import CameraShift
from lidcam.checks.calibration.lidar_ground import inverted_lidars, tilted_lidars
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.frame import FrameResult, SensorBundle
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.streams.decoders import CloudDecoder
from lidcam.run.warning import RunWarning

MAX_POINTS = 200_000
"""Points of each lidar that are looked at, every n-th: their clouds are held for the whole run."""


class CalibrationCheck:
    """Looks at the poses of lidars and cameras over a run."""

    def __init__(self, rig: Rig, config: Config) -> None:
        # Here: `lidcam inspect` looks at the first clouds alone, and need not import what is compiled.
        from lidcam.checks.calibration.self_check import SelfCheck

        self._rig, self._config = rig, config
        self._fit, self._shift, self._points = CameraFit(rig), CameraShift(rig), CameraPoints(rig)
        self._small = SelfCheck(rig, config)
        self._decode = CloudDecoder(rig, config, on_bad="skip")
        self._lidars = {lidar.topic for lidar in rig.lidars}
        self._clouds: dict[str, PointCloud] = {}  # the first of each lidar: one may begin late

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        bundle = frame.bundle
        if len(self._clouds) < len(self._lidars):
            known = {lidar.topic for lidar in self._rig.lidars if lidar.name in self._clouds}
            messages = {topic: message for topic, message in bundle.messages.items() if topic not in known}
            found = self._decode(replace(bundle, messages=messages))
            self._clouds |= {name: _thinned(cloud) for name, cloud in found.items() if len(cloud)}
        if self._lidars <= bundle.messages.keys():  # a camera may see only what a missing lidar does
            combined = frame.combined
            self._points.add(combined.cloud.xyz, combined.ground_cloud.xyz)
            self._fit.add(frame)
            self._shift.add(frame)
            self._small.add(frame)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each sensor whose calibration cannot be right.

        Of cameras only where that of the lidars can: objects in the wrong place match no camera. Of several for a
        sensor the one that says most: the step in the image only where there are too few pairs for more.
        """
        if of_lidars := _lidars_off(self._rig, self._config, self._clouds):
            return of_lidars
        found: dict[str, RunWarning] = {}
        misfits, small_misfits = self._fit.warnings()
        judged = {camera.name for camera, _, _, error, _ in self._small.cameras if error is not None}
        steps = (warning for warning in self._shift.warnings if warning.subject not in judged)
        for warning in (*misfits, *self._small.warnings, *steps, *small_misfits, *self._points.warnings):
            found.setdefault(warning.subject, warning)
        return tuple(found.values())


def check_first_clouds(rig: Rig, config: Config, messages: Iterable[RawMessage]) -> tuple[RunWarning, ...]:
    """Warnings of calibration that the first message of each lidar contradicts; one is held at a time."""
    decode = CloudDecoder(rig, config, on_bad="skip")
    clouds: dict[str, PointCloud] = {}
    for message in messages:
        found = decode(SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message}))
        clouds |= {name: _thinned(cloud) for name, cloud in found.items()}
    points = CameraPoints(rig)
    poses = {lidar.name: lidar.T_site_lidar for lidar in rig.lidars}
    sites = [poses[name].apply(cloud.xyz) for name, cloud in clouds.items()]
    points.add(*sites)
    return _lidars_off(rig, config, clouds) or points.warnings


def _lidars_off(rig: Rig, config: Config, clouds: dict[str, PointCloud]) -> tuple[RunWarning, ...]:
    return inverted_lidars(rig, config.combine, clouds) or tilted_lidars(rig, config.combine, clouds)


def _thinned(cloud: PointCloud) -> PointCloud:
    return cloud if len(cloud) <= MAX_POINTS else cloud.select(np.arange(0, len(cloud), -(-len(cloud) // MAX_POINTS)))
