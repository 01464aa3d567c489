"""The check of a rig by the recording itself: a run that writes nothing, and what it says of poses and clocks."""

from lidcam.checks.calibration.self_check import SelfCheck
from lidcam.processing import RunObserver, process_recording
from lidcam.run.frame import Frame
from lidcam.run.frames import RunInput
from lidcam.run.job import Job
from lidcam.run.tally import RunProgress


def check_rig(job: Job, observer: RunObserver | None = None) -> SelfCheck:
    """Process a recording, and judge its rig.

    Args:
        job: The recording and the settings, without outputs.
        observer: Looks on.

    Raises:
        LidcamError: the input, the calibration or the settings are at fault.
    """
    checker = _Checker(observer or RunObserver())
    process_recording(job, checker)
    return checker.check


class _Checker(RunObserver):
    """Shows each frame to the check, and all to another observer."""

    check: SelfCheck

    def __init__(self, other: RunObserver) -> None:
        self._other = other

    def opened(self, source: RunInput) -> None:
        self.check = SelfCheck(source.rig, source.config)
        self._other.opened(source)

    def frame(self, result: Frame) -> None:
        self.check.add(result)
        self._other.frame(result)

    def advanced(self, progress: RunProgress) -> None:
        self._other.advanced(progress)
