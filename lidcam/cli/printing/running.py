"""A run on the screen: its progress, and optionally its frames."""

import gc
import time
from collections.abc import Callable
from contextlib import ExitStack

from rich.console import Console

from lidcam.cli.printing.console import print_detections, print_matches
from lidcam.cli.printing.progress import show_progress
from lidcam.pipeline.core.frame import FrameResult
from lidcam.processing import RunObserver
from lidcam.run.frames import RunInput
from lidcam.run.tally import RunProgress


class ShownProgress(RunObserver):
    """Shows the progress of a run in recorded seconds, until the stack is closed."""

    def __init__(self, stack: ExitStack, *, has_bar: bool = True, whatever_is_logged: bool = False) -> None:
        self._stack, self._has_bar, self._whatever_is_logged = stack, has_bar, whatever_is_logged

    def opened(self, source: RunInput) -> None:
        """Begin with the seconds to be processed."""
        recording, window = source.recording, source.window
        self._start_ns = window.start_ns or recording.start_ns
        stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
        self._started_s, self._seconds = time.monotonic(), (stop_ns - self._start_ns) / 1e9
        self._advance: Callable[[float, str], None] = lambda *_: None
        if self._has_bar:
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


class ShownRun(ShownProgress):
    """Shows a run until the stack is closed, with the detections and matches of each frame if asked for."""

    def __init__(self, out: Console, stack: ExitStack, *, detections: bool = False, matches: bool = False) -> None:
        # On a terminal, printed frames show the progress, and a bar would break into them.
        super().__init__(stack, has_bar=not (out.is_terminal and (detections or matches)))
        self._out, self._detections, self._matches = out, detections, matches

    def opened(self, source: RunInput) -> None:
        """Begin."""
        gc.freeze()  # libraries and stages stay: looking for garbage among them takes 5 ms a frame
        self._config = source.config
        super().opened(source)

    def frame(self, result: FrameResult) -> None:
        """Print what is asked for."""
        if self._detections:
            print_detections(self._out, result, self._config)
        if self._matches:
            print_matches(self._out, result, self._config)
