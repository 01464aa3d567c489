"""What `lidcam process` does."""

import json
from contextlib import ExitStack
from dataclasses import dataclass

from rich.console import Console

from lidcam.frames import RunInput
from lidcam.job import Job
from lidcam.printing.console import print_detections, print_matches, print_report
from lidcam.printing.terminal import console, progress_bar
from lidcam.run import RunObserver, process_recording
from lidcam.summary import report_tree
from pipeline.core.frame import FrameResult

__all__ = ["Printed", "run_process"]


@dataclass(frozen=True, slots=True)
class Printed:
    """What is printed.

    Attributes:
        detections: What the lidars saw, frame by frame.
        matches: Which 2D box is which object, frame by frame.
        as_json: The final tables as JSON.
    """

    detections: bool = False
    matches: bool = False
    as_json: bool = False


def run_process(job: Job, printed: Printed = Printed()) -> None:
    """Process a recording and print the final tables.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    out = console()
    with ExitStack() as stack:
        report = process_recording(job, _Terminal(printed, out, stack))
    if printed.as_json:
        out.print_json(json.dumps(report_tree(report)))
    else:
        print_report(out, report)


class _Terminal(RunObserver):
    """Shows progress, and frames where that is asked for."""

    def __init__(self, printed: Printed, out: Console, stack: ExitStack) -> None:
        self._printed, self._out, self._stack = printed, out, stack

    def opened(self, source: RunInput) -> None:
        recording, window = source.recording, source.window
        self._config = source.config
        self._start_ns = window.start_ns or recording.start_ns
        stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
        bar = progress_bar(console(stderr=True), (stop_ns - self._start_ns) / 1e9)
        self._progress = self._stack.enter_context(bar)

    def frame(self, result: FrameResult) -> None:
        self._progress((result.bundle.log_time_ns - self._start_ns) / 1e9)
        if self._printed.detections:
            print_detections(self._out, result, self._config)
        if self._printed.matches:
            print_matches(self._out, result, self._config)
