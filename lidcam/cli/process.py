"""The command `lidcam process`, which is also the program `lidcam-process`."""

import logging
import os
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

import typer

from lidcam.cli.options import (
    CHECKING,
    OUTPUTS,
    SCREEN,
    AsJson,
    JsonFile,
    Version,
    option,
    output_option,
    with_job_options,
    with_log_options,
)
from lidcam.cli.printing.log import is_verbose
from lidcam.cli.printing.numbers import Units
from lidcam.cli.verdict import Verdict, strict_failure
from lidcam.outputs.registry import endings_of, usual_endings
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.parallel.cores import THREADS_OF_LIBRARIES
from lidcam.readers.location import ENDINGS, Location, location, recording_stem
from lidcam.run.options import CLI_OPTIONS, JobOptions

if TYPE_CHECKING:
    from lidcam.run.job import Job
    from lidcam.run.summary import RunSummary

logger = logging.getLogger(__name__)

PROCESS_EXAMPLES = """\
Exit codes: 0 done, nothing is missing; 1 failed, nothing was written (if
--strict is not met, the outputs are kept); 2 wrong usage; 3 done, but part
of the recording could not be used. See the last lines on stderr.

\b
Examples:
  lidcam process drive.bag
  lidcam process drive.bag out.mcap --rerun out.rrd --objects out.csv
  lidcam process bag_folder out.mcap --model-2d yolox-nano
  lidcam process drive.bag out.mcap --rig site.yaml --start 30 --duration 10
  lidcam process part_0.mcap part_1.mcap out.mcap --set sync.slop_s=0.05
  lidcam process https://host/drive.mcap out.mcap --start 30 --duration 10
"""


@with_log_options
@with_job_options(*CLI_OPTIONS)
def process(
    paths: Annotated[
        list[str],
        typer.Argument(
            metavar="IN [IN ...] [OUT.mcap]",
            help="Recording (.bag, ROS 2 folder, .mcap, .db3, .pcap, or the URL of an .mcap), then the output; both "
            "may be s3://. Without an output, drive.bag becomes .mcap, .rrd and .html in the folder drive.lidcam.",
        ),
    ],
    out: Annotated[
        str | None,
        option("Folder or file to write the result to.", "--out", "-o", metavar="DIR|OUT.mcap", group=OUTPUTS),
    ] = None,
    rerun: Annotated[str | None, output_option("Also write a Rerun recording.", *endings_of("--rerun"))] = None,
    objects: Annotated[
        str | None,
        output_option("Also write a table of the objects, one row per object and frame.", *endings_of("--objects")),
    ] = None,
    report: Annotated[str | None, output_option("Also write a page about the result.", *endings_of("--report"))] = None,
    video: Annotated[
        str | None,
        output_option("Also write a film: all cameras and a top view (extra video).", *endings_of("--video")),
    ] = None,
    print_detections: Annotated[
        bool,
        option("Print each frame's detections by sensor, and the fused objects.", "--print-detections", group=SCREEN),
    ] = False,
    print_matches: Annotated[
        bool, option("Print each frame's matches between 2D boxes and objects.", "--print-matches", group=SCREEN)
    ] = False,
    units: Annotated[Units, option("Unit of speeds on the screen.", group=SCREEN)] = "km/h",
    as_json: AsJson = False,
    json_file: JsonFile = None,
    strict: Annotated[
        bool,
        option(
            "Exit with code 1 if a sensor is left out, a file is damaged, or more than 5 % of a sensor's frames "
            "or a topic's messages are missing; outputs are kept.",
            "--strict",
            group=CHECKING,
        ),
    ] = False,
    _: Version = False,
    **options: Unpack[JobOptions],
) -> None:
    """Turn a recording into fused objects (MCAP, Rerun)."""
    if as_json and (print_detections or print_matches):
        raise typer.BadParameter(
            "prints one JSON document and nothing else: leave out --print-detections and --print-matches, or write it "
            "to a file with --json-file FILE.json",
            param_hint="--json",
        )
    inputs, output, folder = _places(paths, out)
    if folder is not None:
        made = {ending: str(output.with_suffix(ending)) for ending in usual_endings()}
        rerun, report = rerun or made.get(".rrd"), report or made.get(".html")
    if options.get("workers") != 1:
        # Processes already fill the cores; threads of libraries inside of one would only wait for each other.
        # Read once, when the libraries are loaded.
        for name in THREADS_OF_LIBRARIES:
            os.environ.setdefault(name, "1")
    from lidcam.outputs.sending import sent_when_complete
    from lidcam.run.job import make_job

    outputs = [output, *(location(one) for one in (rerun, objects, report, video) if one is not None)]
    with made_folder(folder), sent_when_complete(outputs, inputs, overwrite=options["overwrite"]) as sending:
        job = make_job(inputs, sending.local, **options)
        run_process(
            job,
            detections=print_detections,
            matches=print_matches,
            units=units,
            as_json=as_json,
            json_file=json_file,
            strict=strict,
            send=sending.send,
        )


def _places(paths: Sequence[str], out: str | None) -> "tuple[list[Location], Any, Path | None]":
    """The inputs, the result, and the folder that it is written into if only that is known."""
    *inputs, last = map(location, paths)
    if out is not None or not inputs:
        if out is not None and inputs and _is_output(last):
            raise typer.BadParameter(f"names the output, and so does {last}: leave one out", param_hint="--out")
        inputs = [*inputs, last]
        if out is not None and out.endswith(".mcap"):
            return inputs, location(out), None
        folder = _folder(inputs[0]) if out is None else location(out)
        if not isinstance(folder, Path):
            raise typer.BadParameter(f"on a server, name the result: {out}/OUT.mcap", param_hint="--out")
        return inputs, folder / f"{recording_stem(inputs[0].name)}.mcap", folder
    if not last.name.endswith(".mcap"):
        is_recording = last.name.endswith(ENDINGS) or (isinstance(last, Path) and last.exists())
        several = f"; for several recordings: lidcam batch {shlex.join(paths)} --out DIR"
        what = several if is_recording else " (see --rerun, --report, --objects)"
        raise typer.BadParameter(f"the output comes last and ends in .mcap, found {last}{what}", param_hint="OUT.mcap")
    return inputs, last, None


def _is_output(place: Location) -> bool:
    """Whether a place is a result, or an MCAP that is not there yet."""
    from lidcam.outputs.allowed import is_own_mcap

    return isinstance(place, Path) and place.suffix == ".mcap" and (not place.exists() or is_own_mcap(place))


def _check_single(folder: Path) -> None:
    """Check that a folder is one recording: a ROS 2 bag, not recordings of several formats or names."""
    if not folder.is_dir() or (folder / "metadata.yaml").exists():
        return
    names = sorted(path.name for path in folder.iterdir() if path.name.lower().endswith(ENDINGS))
    stems = {re.sub(r"_\d+$", "", recording_stem(name)) for name in names}
    if len(stems) > 1 or any(name.endswith(".bag") for name in names):
        count = f"{len(names)} recording{'s' * (len(names) != 1)}"
        raise typer.BadParameter(
            f"{folder} holds {count}; process all of them: lidcam batch {shlex.quote(str(folder))} --out DIR",
            param_hint="IN",
        )


def _folder(recording: Location) -> Path:
    """The folder for the result of a recording: beside it; of one on a server, in the working folder."""
    from lidcam.outputs.allowed import is_own_mcap

    if isinstance(recording, Path):
        inside = sorted(recording.glob("*.mcap")) if recording.is_dir() else [recording]
        if recording.suffix in {".rrd", ".html"} or any(
            path.suffix == ".mcap" and is_own_mcap(path) for path in inside
        ):
            raise typer.BadParameter(
                f"{recording} is a result of lidcam: `lidcam view {shlex.quote(str(recording))}` opens it; to process "
                "it as a recording, name an output",
                param_hint="IN",
            )
        _check_single(recording)
    name = f"{recording_stem(recording.name)}.lidcam"
    return recording.with_name(name) if isinstance(recording, Path) else Path(name)


@contextmanager
def made_folder(folder: Path | None) -> Iterator[None]:
    """Make a folder for the outputs, which goes again, with the parents made for it, if nothing is written into it."""
    made = [] if folder is None else [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise OutputError(f"{folder}: cannot write there: {err.strerror or err}; choose another folder") from err
    try:
        yield
    finally:
        with suppress(OSError):  # it holds the outputs
            for one in made:
                one.rmdir()


def run_process(
    job: "Job",
    *,
    detections: bool = False,
    matches: bool = False,
    units: "Units" = "km/h",
    as_json: bool = False,
    json_file: Path | None = None,
    strict: bool = False,
    send: "Callable[[RunSummary], RunSummary]" = lambda summary: summary,
) -> None:
    """Process a recording, put its complete outputs in place with `send`, and print a summary.

    Ends with CheckError or IncompleteError where too little of the recording could be used; the outputs are kept.
    """
    from lidcam.cli.json_output import figures_document, json_output
    from lidcam.cli.printing.run import print_details, print_summary
    from lidcam.cli.printing.running import ShownRun
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.outputs.open import written_files
    from lidcam.processing import process_recording
    from lidcam.run.choice import used_record
    from lidcam.run.summary import summary_tree

    out = console()
    others = (*job.inputs, *written_files(job), *job.read_files)
    with json_output(json_file, inputs=others, overwrite=job.overwrite) as write_json:
        with ExitStack() as stack:
            shown = ShownRun(out, stack, detections=detections, matches=matches)
            summary = process_recording(job, shown)
        failure = strict_failure(summary) if strict else ""
        verdict = Verdict((failure,) if failure else (), summary.incomplete)
        summary = send(summary)
        tree = figures_document(
            "process",
            inputs=summary.inputs.files,
            settings=used_record(summary.settings) | {"sha256": summary.settings_sha256},
            figures=summary_tree(summary),
            verdict=verdict,
            warnings=summary.warnings,
            notes=summary.notes,
        )
        write_json(tree)
    for drop in summary.drops.messages:
        logger.info("dropped: %s: %d messages: %s %s", drop.topic, drop.count, drop.reason, drop.example)
    for warning in summary.warnings:
        logger.info("warning: %s", warning)
    rate_hz = summary.timing.frames_per_second
    logger.info("done: %d frames, %.1f per second, written: %s", summary.frames.count, rate_hz, summary.outputs)
    if as_json:
        show_json(out, tree)
    else:
        if is_verbose():
            print_details(out, summary)
            out.print()
        print_summary(out, summary, units)
    verdict.end()
