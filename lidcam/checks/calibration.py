"""Calibration that cannot be right."""

from collections.abc import Mapping

import numpy as np

from lidcam.checks.camera_fit import CameraFit
from lidcam.checks.camera_points import CameraPoints
from lidcam.checks.lidar_ground import inverted_lidars
from lidcam.checks.warning import RunWarning
from pipeline.core.clouds import PointCloud
from pipeline.core.frame import FrameResult, SensorBundle
from pipeline.core.messages import RawMessage
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from readers.streams.decoders import CloudDecoder

__all__ = ["CalibrationCheck", "check_first_clouds"]


class CalibrationCheck:
    """Looks at the poses of lidars and cameras over a run."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._rig, self._config = rig, config
        self._fit, self._points = CameraFit(rig), CameraPoints(rig)
        self._of_lidars: tuple[RunWarning, ...] | None = None

    def add(self, frame: FrameResult) -> None:
        """Look at one frame."""
        if self._of_lidars is None:
            self._of_lidars = inverted_lidars(
                self._rig, self._config.combine, _clouds(self._rig, self._config, frame.bundle)
            )
        combined = frame.combined
        self._points.add(np.concatenate([combined.cloud.xyz, combined.ground_cloud.xyz]))
        self._fit.add(frame)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each sensor whose calibration cannot be right.

        Of cameras only where the lidars' is: objects in the wrong place fit no camera.
        """
        if self._of_lidars:
            return self._of_lidars
        of_boxes, of_points = self._fit.warnings, self._points.warnings
        told = {warning.subject for warning in of_boxes}
        return of_boxes + tuple(warning for warning in of_points if warning.subject not in told)


def check_first_clouds(rig: Rig, config: Config, messages: Mapping[str, RawMessage]) -> tuple[RunWarning, ...]:
    """What the first message of each lidar, by topic, says of the calibration."""
    if not messages:
        return ()
    stamp_ns = min(message.stamp_ns for message in messages.values())
    clouds = _clouds(rig, config, SensorBundle(0, stamp_ns, stamp_ns, messages))
    points = CameraPoints(rig)
    poses = {lidar.name: lidar.T_site_lidar for lidar in rig.lidars}
    sites = [poses[name].apply(cloud.xyz) for name, cloud in clouds.items()]
    points.add(np.concatenate([np.zeros((0, 3), np.float32), *sites]))
    return inverted_lidars(rig, config.combine, clouds) or points.warnings


def _clouds(rig: Rig, config: Config, bundle: SensorBundle) -> Mapping[str, PointCloud]:
    """Clouds by lidar name, each in the frame of its lidar; without those that cannot be decoded."""
    return CloudDecoder(rig, config, on_bad="skip")(bundle)
