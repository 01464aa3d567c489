"""The progress of a run on the screen."""

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from lidcam.cli.printing.progress import show_progress
from lidcam.processing import RunObserver
from lidcam.run.frames import RunInput
from lidcam.run.tally import RunProgress

if TYPE_CHECKING:
    from lidcam.evaluation.requirement import Requirement

SOURCES = ("lidar", "fused")
"""Sources of 3D boxes in every result."""


@contextmanager
def shown_run(requirements: "Sequence[Requirement]" = ()) -> Iterator[RunObserver]:
    """An observer that shows the progress of a run.

    Raises:
        RequirementError: a requirement names an unknown figure; found when the recording is open.
    """
    with ExitStack() as stack:
        yield _ShownRun(stack, requirements)


class ShownProgress(RunObserver):
    """Shows the progress of a run in recorded seconds, until the stack is closed."""

    def __init__(self, stack: ExitStack, *, whatever_is_logged: bool = False) -> None:
        self._stack, self._whatever_is_logged = stack, whatever_is_logged

    def opened(self, source: RunInput) -> None:
        """Begin with the seconds to be processed."""
        recording, window = source.recording, source.window
        self._start_ns = window.start_ns or recording.start_ns
        stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
        self._started_s = time.monotonic()
        bar = show_progress((stop_ns - self._start_ns) / 1e9, whatever_is_logged=self._whatever_is_logged)
        self._advance = self._stack.enter_context(bar)

    def advanced(self, progress: RunProgress) -> None:
        """Show the progress."""
        rate_hz = progress.frames / max(time.monotonic() - self._started_s, 1e-3)
        objects = f"{progress.objects} objects" if progress.objects else "no objects yet"  # offline, a window late
        self._advance(
            (progress.log_time_ns - self._start_ns) / 1e9,
            f"{progress.frames} frames, {rate_hz:.1f} per second, {objects}, {progress.drops} dropped",
        )


class _ShownRun(ShownProgress):
    def __init__(self, stack: ExitStack, requirements: "Sequence[Requirement]") -> None:
        super().__init__(stack)
        self._requirements = requirements

    def opened(self, source: RunInput) -> None:
        gc.freeze()  # libraries and stages stay: looking for garbage among them takes 5 ms a frame
        if self._requirements:
            from lidcam.evaluation.evaluators import known_figures
            from lidcam.evaluation.requirement import check_names

            check_names(self._requirements, known_figures(source.config, source.rig, SOURCES))
        super().opened(source)
