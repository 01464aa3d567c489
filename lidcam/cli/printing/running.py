"""A run on the screen: its progress, and optionally its frames."""

import gc
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from rich.console import Console

from lidcam.cli.printing.console import print_detections, print_matches
from lidcam.cli.printing.progress import show_progress
from lidcam.pipeline.core.frame import FrameResult
from lidcam.processing import RunObserver
from lidcam.run.frames import RunInput
from lidcam.run.tally import RunProgress

if TYPE_CHECKING:
    from lidcam.evaluation.requirement import Requirement

SOURCES = ("lidar", "fused")
"""Sources of 3D boxes in every result."""


class ShownProgress(RunObserver):
    """Shows the progress of a run in recorded seconds, until the stack is closed."""

    def __init__(self, stack: ExitStack, *, whatever_is_logged: bool = False) -> None:
        self._stack, self._whatever_is_logged = stack, whatever_is_logged

    def opened(self, source: RunInput) -> None:
        """Begin with the seconds to be processed."""
        recording, window = source.recording, source.window
        self._start_ns = window.start_ns or recording.start_ns
        stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
        self._started_s, self._seconds = time.monotonic(), (stop_ns - self._start_ns) / 1e9
        bar = show_progress(self._seconds, whatever_is_logged=self._whatever_is_logged)
        self._advance = self._stack.enter_context(bar)

    def advanced(self, progress: RunProgress) -> None:
        """Show the progress."""
        rate_hz = progress.frames / max(time.monotonic() - self._started_s, 1e-3)
        written = f"{progress.written} written" if progress.written else "tracks follow"
        drops = f", {progress.drops} dropped" if progress.drops else ""
        self._advance(
            (progress.log_time_ns - self._start_ns) / 1e9,
            f"{progress.frames} frames, {rate_hz:.1f}/s, {progress.detections} detections, {written}{drops}",
        )

    def finishing(self) -> None:
        """Show that only the outputs of the whole result are left."""
        self._advance(self._seconds, "all frames written, finishing the outputs")


class ShownRun(RunObserver):
    """Shows a run until the stack is closed, with the detections and matches of each frame if asked for."""

    def __init__(
        self,
        out: Console,
        stack: ExitStack,
        requirements: "Sequence[Requirement]" = (),
        *,
        detections: bool = False,
        matches: bool = False,
    ) -> None:
        self._out, self._requirements = out, requirements
        self._detections, self._matches = detections, matches
        # On a terminal, printed frames show the progress, and a bar would break into them.
        self._progress = RunObserver() if out.is_terminal and (detections or matches) else ShownProgress(stack)

    def opened(self, source: RunInput) -> None:
        """Begin; a requirement of an unknown figure raises RequirementError."""
        gc.freeze()  # libraries and stages stay: looking for garbage among them takes 5 ms a frame
        if self._requirements:
            from lidcam.evaluation.evaluators import known_figures
            from lidcam.evaluation.requirement import check_names

            check_names(self._requirements, known_figures(source.config, source.rig, SOURCES))
        self._config = source.config
        self._progress.opened(source)

    def frame(self, result: FrameResult) -> None:
        """Print what is asked for."""
        if self._detections:
            print_detections(self._out, result, self._config)
        if self._matches:
            print_matches(self._out, result, self._config)

    def advanced(self, progress: RunProgress) -> None:
        """Show the progress."""
        self._progress.advanced(progress)

    def finishing(self) -> None:
        """Show what is left."""
        self._progress.finishing()
