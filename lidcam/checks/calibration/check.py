"""Warnings of a run about calibration that cannot be right."""

from lidcam.checks.calibration.first_clouds import FirstClouds
from lidcam.checks.calibration.rig_check import RigCheck
from lidcam.pipeline.calibration.lidar_poses import NOT_COMPARED, ComparedLidars
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.warning import RunWarning


class CalibrationCheck:
    """Checks the poses and clocks of lidars and cameras over a run."""

    def __init__(self, rig: Rig, config: Config, compared: ComparedLidars = NOT_COMPARED) -> None:
        self._first_clouds, self._rig_check = FirstClouds(rig, config), RigCheck(rig, config, compared)

    def add_frame(self, frame: FrameResult) -> None:
        """Add one frame."""
        self._first_clouds.add_messages(frame.bundle.messages.values())
        self._rig_check.add_frame(frame)

    @property
    def warnings(self) -> tuple[RunWarning, ...]:
        """One for each sensor at most; cameras only where the lidars are right: misplaced objects match no camera.

        Those that are not used are always named.
        """
        if of_lidars := self._first_clouds.lidar_warnings:
            unused = (one.warning for one in self._rig_check.cameras if not one.camera.fit.is_used)
            return (*of_lidars, *filter(None, unused))
        found: dict[str, RunWarning] = {}
        for warning in (*self._rig_check.warnings, *self._first_clouds.camera_warnings):
            found.setdefault(warning.subject, warning)
        return tuple(found.values())
