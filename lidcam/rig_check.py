"""Checks a rig by the recording itself, in a run that writes nothing."""

from lidcam.checks.calibration.rig_check import RigCheck
from lidcam.processing import RunObserver, process_recording
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.run.tally import RunProgress


def check_rig(job: Job, observer: RunObserver | None = None) -> RigCheck:
    """Process a recording, and judge its rig.

    Args:
        job: The recording and the settings, without outputs.
        observer: Observer of the run.

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    checker = _Checker(observer or RunObserver())
    process_recording(job, checker)
    return checker.check


class _Checker(RunObserver):
    """Passes each frame to the check, and everything to another observer."""

    check: RigCheck

    def __init__(self, other: RunObserver) -> None:
        self._other = other

    def opened(self, source: RunInput) -> None:
        self.check = RigCheck(source.rig, source.config)
        self._other.opened(source)

    def frame(self, result: Frame) -> None:
        self.check.add_frame(result)
        self._other.frame(result)

    def advanced(self, progress: RunProgress) -> None:
        self._other.advanced(progress)
