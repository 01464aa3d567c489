"""The command `lidcam process`, which is also the program `lidcam-process`."""

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lidcam.cli.options import (
    AsJson,
    ConfigFile,
    CopyTopics,
    Duration,
    Every,
    JsonFile,
    Model2d,
    Model3d,
    OnBad,
    Overwrite,
    Require,
    RigFile,
    Setting,
    Start,
    Version,
    Workers,
    named_as,
    requirement_errors,
    with_log_options,
)
from lidcam.cli.printing.compiling import compiled_together
from lidcam.cli.printing.log import is_verbose, remark_log
from lidcam.cli.strict import MAX_DROPPED_PERCENT, strict_failure
from lidcam.cli.verdict import Verdict
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES
from lidcam.readers.location import location

if TYPE_CHECKING:
    from lidcam.evaluation.evaluation import Evaluation
    from lidcam.evaluation.requirement import Requirement
    from lidcam.run.job import Job
    from lidcam.run.summary import RunSummary

logger = logging.getLogger(__name__)

# \b keeps the lines of a paragraph as they are.
PROCESS_EXAMPLES = """\b
Exit codes: 0 done, and nothing is missing; 1 failed, nothing was written (or
--strict or --require is not met, and the outputs are kept); 2 wrong usage;
3 done, but part of the recording could not be used. The last lines on stderr
say what.

\b
Examples:
  lidcam-process drive.bag out.mcap --rerun out.rrd --objects out.csv
  lidcam-process bag_folder out.mcap --model-2d yolox-nano
  lidcam-process drive.bag out.mcap --rig site.yaml --start 30 --duration 10
  lidcam-process part_0.mcap part_1.mcap out.mcap --set sync.slop_s=0.05
  lidcam-process https://host/drive.mcap out.mcap --start 30 --duration 10
  lidcam-process drive.bag out.mcap --require "fused.car.recall > 0.8"
"""


@with_log_options
def process(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="IN [IN ...] OUT.mcap",
            help="Recording (.bag, ROS 2 folder, .mcap, .db3, .pcap, or the URL of an .mcap), then output, also s3://.",
        ),
    ],
    config_file: ConfigFile = None,
    settings: Setting = None,
    rig_files: RigFile = None,
    rerun: Annotated[
        str | None,
        typer.Option(metavar="OUT.rrd", callback=named_as("--rerun"), help="Also write a Rerun recording."),
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(
            metavar="OUT.csv|OUT.parquet",
            callback=named_as("--objects"),
            help="Also write a table of the objects, one row per object and frame.",
        ),
    ] = None,
    report: Annotated[
        str | None,
        typer.Option(metavar="OUT.html", callback=named_as("--report"), help="Also write a page about the result."),
    ] = None,
    save_matches: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=named_as("--save-matches"),
            help="Also write a picture (JPEG) of each camera and frame into this folder: 2D and 3D boxes, matches.",
        ),
    ] = None,
    video: Annotated[
        str | None,
        typer.Option(
            metavar="OUT.mp4",
            callback=named_as("--video"),
            help="Also write a film of all cameras and the site from above (extra video).",
        ),
    ] = None,
    model_2d: Model2d = None,
    model_3d: Model3d = None,
    view: Annotated[
        bool, typer.Option("--view", help="Show the frames in the Rerun viewer while the run goes on.")
    ] = False,
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="Serve the frames to Foxglove while the run goes on; without a host, to this machine alone.",
        ),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            metavar="TIMES",
            help="Run no faster than this many times the pace of the recording, as 1; without it, as fast as possible.",
        ),
    ] = None,
    start: Start = 0.0,
    duration_s: Duration = None,
    every: Every = None,
    workers: Workers = None,
    overwrite: Overwrite = False,
    on_bad_message: OnBad = "skip",
    copy_topics: CopyTopics = None,
    print_detections: Annotated[
        bool, typer.Option("--print-detections", help="Print what each sensor and the fusion found, frame by frame.")
    ] = False,
    print_matches: Annotated[
        bool, typer.Option("--print-matches", help="Print which 2D box is which object, frame by frame.")
    ] = False,
    as_json: AsJson = False,
    json_file: JsonFile = None,
    evaluate_: Annotated[
        bool, typer.Option("--evaluate", help="Then measure the result, as `lidcam evaluate` does.")
    ] = False,
    requirements: Require = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Exit with 1 if a sensor was left out or fell silent, too much of a topic was dropped, or a file is "
            "damaged; the outputs are kept.",
        ),
    ] = False,
    max_dropped: Annotated[
        float | None,
        typer.Option(
            "--max-dropped",
            min=0,
            max=100,
            metavar="PERCENT",
            help="How much of a topic, and of the frames of a sensor, may be missing with --strict.  [default: 5]",
        ),
    ] = None,
    _: Version = False,
) -> None:
    """Turn a recording into fused objects (MCAP, Rerun)."""
    if len(paths) < 2:
        raise typer.BadParameter("expected at least one recording and the output", param_hint="IN OUT.mcap")
    *inputs, output = map(location, paths)
    if not output.name.endswith(".mcap"):
        raise typer.BadParameter(f"the output comes last and ends in .mcap, found {output}", param_hint="OUT.mcap")
    if as_json and (print_detections or print_matches):
        raise typer.BadParameter(
            "prints one JSON document and nothing else: leave out --print-detections and --print-matches, or write it "
            "to a file with --json-file FILE.json",
            param_hint="--json",
        )
    if max_dropped is not None and not strict:
        raise typer.BadParameter("counts only with --strict, which is missing", param_hint="--max-dropped")
    if workers != 1:
        # Processes already fill the cores; threads of libraries inside of one would only wait for each other.
        # Read once, when the libraries are loaded.
        for name in THREADS_OF_LIBRARIES:
            os.environ.setdefault(name, "1")
    from lidcam.outputs.sending import sent_when_complete
    from lidcam.run.job import make_job

    others = [location(one) for one in (rerun, objects, report, video) if one is not None]
    with requirement_errors(), sent_when_complete([output, *others], inputs, overwrite=overwrite) as sending:
        required: Sequence[Requirement] | None = () if evaluate_ else None
        if requirements:
            from lidcam.evaluation.requirement import read_requirements

            required = read_requirements(requirements)
        job = make_job(
            inputs,
            sending.local,
            config=config_file,
            settings=settings or (),
            rig=rig_files,
            model_2d=model_2d,
            model_3d=model_3d,
            copy_topics=copy_topics or None,
            workers=workers,
            start_s=start,
            duration_s=duration_s,
            every=every,
            on_bad_message=on_bad_message,
            overwrite=overwrite,
            view=view,
            foxglove=foxglove,
            pace=pace,
            save_matches=save_matches,
        )
        if job.foxglove is not None:
            remark_log.info("in Foxglove: Open connection, ws://%s:%d", *job.foxglove)
        run_process(
            job,
            detections=print_detections,
            matches=print_matches,
            as_json=as_json,
            json_file=json_file,
            max_dropped_percent=(MAX_DROPPED_PERCENT if max_dropped is None else max_dropped) if strict else None,
            requirements=required,
            send=sending.send,
        )


def run_process(
    job: "Job",
    *,
    detections: bool = False,
    matches: bool = False,
    as_json: bool = False,
    json_file: Path | None = None,
    max_dropped_percent: float | None = None,
    requirements: "Sequence[Requirement] | None" = None,
    send: "Callable[[RunSummary], RunSummary]" = lambda report: report,
) -> None:
    """Process a recording and print the final tables.

    Args:
        job: The recording, the settings and the outputs.
        detections: Print what each sensor and the fusion found, frame by frame.
        matches: Print which 2D box is which object, frame by frame.
        as_json: Print JSON in place of the tables.
        json_file: Where the JSON is written; None: nowhere.
        max_dropped_percent: Limit of `--strict`; None: not strict.
        requirements: Limits that the figures of the result must meet; None: the result is not evaluated.
        send: Called with the report when the outputs are complete; puts them where they belong.

    Raises:
        RequirementError: a requirement names a figure that there cannot be; nothing is processed.
        CheckError: the run used less of the recording than it has to, or a requirement is not met; the outputs stay.
        IncompleteError: part of the recording could not be used; the outputs stay.
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    with compiled_together(shown=True):
        from lidcam.processing import process_recording
    from lidcam.cli.json_output import json_output
    from lidcam.cli.printing.console import print_report
    from lidcam.cli.printing.running import shown_run
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.outputs.open import written_files

    out = console()
    others = (*job.inputs, *written_files(job), *job.read_files)
    with json_output(json_file, inputs=others, overwrite=job.overwrite) as write_json:
        with shown_run(out, requirements or (), detections=detections, matches=matches) as observer:
            report = process_recording(job, observer)
        evaluation = None if requirements is None else _evaluated(job, requirements)
        failure = "" if max_dropped_percent is None else strict_failure(report, max_dropped_percent)
        failures = ((failure,) if failure else ()) + (evaluation.failures if evaluation else ())
        verdict = Verdict(failures, report.incomplete)
        report = send(report)
        tree = _tree(report, evaluation, verdict)
        write_json(tree)
    for drop in report.drops.messages:
        logger.info("dropped: %s: %d messages: %s %s", drop.topic, drop.count, drop.reason, drop.example)
    for warning in report.warnings:
        logger.info("warning: %s", warning)
    rate_hz = report.timing.frames_per_second
    logger.info("done: %d frames, %.1f a second, written: %s", report.frames.count, rate_hz, report.outputs)
    if as_json:
        show_json(out, tree)
    else:
        print_report(out, report, times=is_verbose())
    if evaluation is not None and not as_json:
        from lidcam.cli.printing.evaluation import print_evaluation

        out.print()
        print_evaluation(out, evaluation)
    verdict.end()


def _evaluated(job: "Job", requirements: "Sequence[Requirement]") -> "Evaluation":
    from lidcam.cli.printing.progress import show_progress
    from lidcam.evaluation.evaluate import evaluate_result
    from lidcam.evaluation.evaluation import EvaluationJob

    (result,) = (path for path in job.outputs if path.suffix == ".mcap")
    return evaluate_result(EvaluationJob(result, requirements=tuple(requirements)), show_progress)


def _tree(report: "RunSummary", evaluation: "Evaluation | None", verdict: Verdict) -> dict[str, Any]:
    from lidcam.cli.json_output import figures_document
    from lidcam.run.choice import used_record
    from lidcam.run.summary import summary_tree

    figures = summary_tree(report)
    if evaluation is not None:
        measured = evaluation.tree()
        both = {key: figures[key] | measured.get(key, {}) for key in ("sync", "timing")}
        figures = {**figures, **measured, **both}
    return figures_document(
        "process",
        inputs=report.inputs.files,
        settings=used_record(report.settings) | {"sha256": report.settings_sha256},
        truth=evaluation.truth.tree() if evaluation and evaluation.truth else None,
        figures=figures,
        verdict=verdict,
        warnings=(*report.warnings, *(evaluation.warnings if evaluation else ())),
        notes=(*report.notes, *(evaluation.notes if evaluation else ())),
    )
