"""What `lidcam process` does."""

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from rich.console import Console

from lidcam.commands.envelope import envelope
from lidcam.commands.json_output import json_output
from lidcam.commands.strict import Strictness
from lidcam.commands.verdict import Verdict
from lidcam.frames import RunInput
from lidcam.job import Job
from lidcam.printing.console import print_detections, print_matches, print_report
from lidcam.printing.progress import Advance, show_progress
from lidcam.printing.terminal import console
from lidcam.run import RunObserver, process_recording
from lidcam.settings.choice import used_record
from lidcam.summary import RunProgress, RunReport, report_tree
from pipeline.core.frame import FrameResult

__all__ = ["Printed", "run_process"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Printed:
    """What is printed.

    Attributes:
        detections: What the lidars saw, frame by frame.
        matches: Which 2D box is which object, frame by frame.
        json: Where the final tables go as JSON: None, `-` for standard output in place of the tables, or a file.
    """

    detections: bool = False
    matches: bool = False
    json: str | None = None


def run_process(job: Job, printed: Printed = Printed(), strictness: Strictness | None = None) -> None:
    """Process a recording and print the final tables.

    Raises:
        CheckError: the run used less of the recording than `strictness` asks for; the outputs stay.
        IncompleteError: part of the recording could not be used; the outputs stay.
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    out = console()
    others = (*job.inputs, *job.outputs, *job.read_files)
    with json_output(printed.json, inputs=others, overwrite=job.overwrite) as json:
        with ExitStack() as stack:
            report = process_recording(job, _Terminal(printed, out, stack))
        failure = strictness.failure(report) if strictness else ""
        verdict = Verdict((failure,) if failure else (), report.incomplete)
        json.tree = _tree(report, verdict)
    for drop in report.drops:
        logger.info("dropped: %s: %d messages: %s %s", drop.topic, drop.count, drop.reason, drop.example)
    for warning in report.warnings:
        logger.info("warning: %s", warning)
    logger.info("done: %d frames, %.1f a second, written: %s", report.frames, report.frames_per_second, report.outputs)
    json.show(out, lambda: print_report(out, report))
    verdict.end()


def _tree(report: RunReport, verdict: Verdict) -> dict[str, Any]:
    return envelope(
        "process",
        inputs=report.inputs,
        settings=used_record(report.settings) | {"sha256": report.settings_sha256},
        figures=report_tree(report),
        verdict=verdict,
        warnings=report.warnings,
        notes=report.notes,
    )


class _Terminal(RunObserver):
    """Shows progress, and frames where that is asked for."""

    def __init__(self, printed: Printed, out: Console, stack: ExitStack) -> None:
        self._printed, self._out, self._stack = printed, out, stack

    def opened(self, source: RunInput) -> None:
        recording, window = source.recording, source.window
        self._config = source.config
        self._start_ns = window.start_ns or recording.start_ns
        stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
        self._advance: Advance = _no_progress  # the frames show it on a terminal, where a bar would break into them
        self._started_s = time.monotonic()
        if not (self._out.is_terminal and (self._printed.detections or self._printed.matches)):
            self._advance = self._stack.enter_context(show_progress((stop_ns - self._start_ns) / 1e9))

    def frame(self, result: FrameResult) -> None:
        self._done_s = (result.bundle.log_time_ns - self._start_ns) / 1e9
        if self._printed.detections:
            print_detections(self._out, result, self._config)
        if self._printed.matches:
            print_matches(self._out, result, self._config)

    def advanced(self, progress: RunProgress) -> None:
        rate_hz = progress.frames / max(time.monotonic() - self._started_s, 1e-3)
        self._advance(
            self._done_s,
            f"{progress.frames} frames, {rate_hz:.1f} a second, {progress.objects} objects, {progress.drops} dropped",
        )


def _no_progress(done_s: float, facts: str = "") -> None:
    pass
