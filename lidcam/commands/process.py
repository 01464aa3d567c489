"""The work of `lidcam process`."""

import gc
import logging
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from lidcam.report import RunReport, report_tree
from lidcam.run import RunObserver, process_recording
from lidcam.settings.choice import used_record
from lidcam.summary import RunProgress
from pipeline.core.frame import FrameResult

if TYPE_CHECKING:  # evaluation is imported where a run is evaluated
    from lidcam.evaluation.evaluation import Evaluation
    from lidcam.evaluation.requirement import Requirement

__all__ = ["Printed", "run_process"]

logger = logging.getLogger(__name__)

SOURCES = ("lidar", "fused")
"""Of 3D boxes, in every result."""


@dataclass(frozen=True, slots=True)
class Printed:
    """Choice of what is printed.

    Attributes:
        detections: What the lidars saw, frame by frame.
        matches: Which 2D box is which object, frame by frame.
        as_json: Print JSON in place of the tables.
        json_file: Where the JSON is written; None: nowhere.
    """

    detections: bool = False
    matches: bool = False
    as_json: bool = False
    json_file: Path | None = None


def run_process(
    job: Job,
    printed: Printed = Printed(),
    strictness: Strictness | None = None,
    requirements: "Sequence[Requirement] | None" = None,
) -> None:
    """Process a recording and print the final tables.

    Args:
        job: What to process, and what to write.
        printed: What is printed.
        strictness: How much of the recording the run has to use; None: that does not matter.
        requirements: What is required of the figures of the result, which is then evaluated; None: it is not.

    Raises:
        RequirementError: a requirement names a figure that there cannot be; nothing is processed.
        CheckError: the run used less of the recording than `strictness` asks for, or a requirement is not met; the
            outputs stay.
        IncompleteError: part of the recording could not be used; the outputs stay.
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    out = console()
    others = (*job.inputs, *job.outputs, *job.read_files)
    with json_output(printed.json_file, is_printed=printed.as_json, inputs=others, overwrite=job.overwrite) as json:
        with ExitStack() as stack:
            report = process_recording(job, _Terminal(printed, out, stack, requirements or ()))
        evaluation = None if requirements is None else _evaluated(job, requirements)
        failure = strictness.failure(report) if strictness else ""
        failures = ((failure,) if failure else ()) + (evaluation.failures if evaluation else ())
        verdict = Verdict(failures, report.incomplete)
        json.tree = _tree(report, evaluation, verdict)
    for drop in report.drops.messages:
        logger.info("dropped: %s: %d messages: %s %s", drop.topic, drop.count, drop.reason, drop.example)
    for warning in report.warnings:
        logger.info("warning: %s", warning)
    rate_hz = report.timing.frames_per_second
    logger.info("done: %d frames, %.1f a second, written: %s", report.frames.count, rate_hz, report.outputs)
    json.show(out, lambda: _print(out, report, evaluation))
    verdict.end()


def _evaluated(job: Job, requirements: "Sequence[Requirement]") -> "Evaluation":
    from lidcam.evaluation.evaluate import evaluate_result
    from lidcam.evaluation.evaluation import EvaluationJob

    (result,) = (path for path in job.outputs if path.suffix == ".mcap")
    return evaluate_result(EvaluationJob(result, requirements=tuple(requirements)), show_progress)


def _print(out: Console, report: RunReport, evaluation: "Evaluation | None") -> None:
    print_report(out, report)
    if evaluation is not None:
        from lidcam.printing.evaluation import print_evaluation

        out.print()
        print_evaluation(out, evaluation)


def _tree(report: RunReport, evaluation: "Evaluation | None", verdict: Verdict) -> dict[str, Any]:
    figures = report_tree(report)
    if evaluation is not None:
        measured = evaluation.tree()
        both = {key: figures[key] | measured.get(key, {}) for key in ("sync", "timing")}
        figures = {**figures, **measured, **both}
    return envelope(
        "process",
        inputs=report.inputs.files,
        settings=used_record(report.settings) | {"sha256": report.settings_sha256},
        truth=evaluation.truth.tree() if evaluation and evaluation.truth else None,
        figures=figures,
        verdict=verdict,
        warnings=(*report.warnings, *(evaluation.warnings if evaluation else ())),
        notes=(*report.notes, *(evaluation.notes if evaluation else ())),
    )


class _Terminal(RunObserver):
    """Shows progress, and frames where that is asked for."""

    def __init__(self, printed: Printed, out: Console, stack: ExitStack, requirements: "Sequence[Requirement]") -> None:
        self._printed, self._out, self._stack, self._requirements = printed, out, stack, requirements

    def opened(self, source: RunInput) -> None:
        gc.freeze()  # libraries and stages stay: looking for garbage among them takes 5 ms a frame
        if self._requirements:
            from lidcam.evaluation.evaluators import known_figures
            from lidcam.evaluation.requirement import check_names

            check_names(self._requirements, known_figures(source.config, source.rig, SOURCES))
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
