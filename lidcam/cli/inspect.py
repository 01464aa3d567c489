"""The command `lidcam inspect`."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

import typer

from lidcam.cli.options import (
    CHECKING,
    OUTPUTS,
    AsJson,
    Require,
    option,
    output_option,
    requirement_errors,
    with_job_options,
    with_log_options,
)
from lidcam.cli.printing.log import is_verbose, remark_log
from lidcam.cli.verdict import Verdict, first_of
from lidcam.readers.location import location
from lidcam.run.options import JobOptions

if TYPE_CHECKING:
    from lidcam.checks.calibration.rig_check import RigCheck
    from lidcam.evaluation.requirement import Outcome
    from lidcam.inspection import Inspection
    from lidcam.readers.recording import Recording, TopicInfo
    from lidcam.run.job import Job
    from lidcam.writers.outputs.transaction import OutputFile

INSPECT_EXAMPLES = """\
Exit codes: 0 sound, all sensors usable; 3 messages are lost, or sensors would
be left out; 1 cannot be processed, or a requirement is not met; 2 wrong
usage. With --repair, 0 means that every message was copied.

\b
Examples:
  lidcam inspect drive.bag
  lidcam inspect drive.bag --write-rig rig.yaml
  lidcam inspect bag_folder --json
  lidcam inspect drive.bag --require "skew_max_ms <= 60"
  lidcam inspect broken.bag --repair whole.mcap
  lidcam inspect drive.bag --check --model-2d yolox-nano
  lidcam inspect drive.bag --check --write-rig fixed.yaml
  lidcam inspect s3://bucket/drive.mcap
"""


@with_log_options
@with_job_options("config", "settings", "rig", "model_2d", "model_3d", "device", "overwrite")
def inspect(
    paths: Annotated[list[str], typer.Argument(metavar="IN [IN ...]", help="Recording, or the parts of one.")],
    write_rig: Annotated[Path | None, option("Write a draft rig (YAML).", metavar="FILE", group=OUTPUTS)] = None,
    repair: Annotated[Path | None, output_option("Write all readable messages to a clean MCAP.", ".mcap")] = None,
    check: Annotated[
        bool,
        option(
            "Process the whole recording to check poses and clocks; --write-rig corrects them.",
            "--check",
            group=CHECKING,
        ),
    ] = False,
    requirements: Require = None,
    as_json: AsJson = False,
    **options: Unpack[JobOptions],
) -> None:
    """Show the contents of a recording and what lidcam would use.

    Topics, types, rates, gaps, sensors, sources of calibration, and damage.
    """
    from lidcam.evaluation.requirement import read_requirements
    from lidcam.inspection import inspect_open, inspect_recording
    from lidcam.outputs.allowed import REPAIRED, TEXT, check_no_input, check_replaced, is_own_mcap
    from lidcam.readers.open import open_recording
    from lidcam.readers.recording import ReadOptions
    from lidcam.readers.rig.rig_file import rig_yaml
    from lidcam.readers.streams.per_sensor import sensor_messages
    from lidcam.run.frames import TimeWindow
    from lidcam.run.job import make_job
    from lidcam.run.missing import damage_lines
    from lidcam.writers.outputs.marks import marked_yaml
    from lidcam.writers.outputs.transaction import OutputTransaction

    if check and repair is not None:
        raise typer.BadParameter("not together with --repair: check the repaired recording", param_hint="--check")
    with requirement_errors():
        required = read_requirements(requirements or ())
    job = make_job([location(path) for path in paths], **options)
    files = [file for file in (repair, write_rig) if file is not None]
    check_no_input(files, (*job.inputs, *job.read_files))
    check_old = check_replaced(lambda path: REPAIRED if path == repair else TEXT, overwrite=job.overwrite)
    remarks: list[str] = []
    verdict: Verdict | None = None
    checked: RigCheck | None = None
    whole: Sequence[str] = ()  # what the run of a check could not use
    with OutputTransaction(files, check_old=check_old) as outputs:
        if repair is None:
            inspection = inspect_recording(job.inputs, job.settings, job.rig)
            check_no_input(files, inspection.files)
        else:
            limits = job.config.limits
            with (
                open_recording(job.inputs, ReadOptions("full_scan", limits)) as recorded,
                sensor_messages(recorded, limits=limits) as recording,
            ):
                check_no_input(files, recording.paths)
                inspection = inspect_open(recording, job.settings, job.rig, TimeWindow())
                remarks += _repair(recorded, outputs[repair])
                inspection = replace(inspection, losses=recorded.losses)
                left = [f"{one.topic}: {one.message_count} messages not copied" for one in _unreadable(recorded)]
                verdict = Verdict((), (*damage_lines(recorded.losses), *left))
        if check and not inspection.problem:
            checked, whole = _checked(job)
        if write_rig is not None and checked is not None:
            outputs[write_rig].write_text(marked_yaml(rig_yaml(checked.corrected())))
            remarks.insert(0, f"wrote {write_rig}: {checked.correction_count} corrections")
        elif write_rig is not None:
            if not inspection.draft:  # print what was found, and end without any output
                problem = f"{write_rig}: no rig to write: {inspection.problem}"
                _print(inspection, Verdict((problem,)), (), as_json=as_json, repaired=repair is not None)
            outputs[write_rig].write_text(marked_yaml(inspection.draft))
            remarks.insert(0, f"wrote {write_rig}")
    for path in inspection.files:
        if isinstance(path, Path) and is_own_mcap(path):
            words = f"{path} is a result of lidcam: see lidcam view, report, evaluate, compare and export"
            inspection = replace(inspection, notes=(words, *inspection.notes))
    for remark in remarks:  # the files have their names now
        remark_log.info("%s", remark)
    verdict = verdict or _verdict(inspection, needs_rig=write_rig is None)
    verdict = verdict._replace(incomplete=tuple(dict.fromkeys((*verdict.incomplete, *whole))))
    outcomes = [one.check(inspection.figures) for one in required]
    unmet = (outcome.failure for outcome in outcomes if outcome.failure)
    verdict = verdict._replace(failures=(*verdict.failures, *unmet))
    _print(inspection, verdict, outcomes, as_json=as_json, repaired=repair is not None, checked=checked)


def _verdict(inspection: "Inspection", *, needs_rig: bool) -> Verdict:
    """The verdict of an inspection; one that wrote a draft rig has not failed."""
    problem = f"lidcam could not process it: {inspection.problem}" if inspection.problem else ""
    if problem and needs_rig:
        return Verdict((f"{', '.join(map(str, inspection.files))}: {problem}",))
    return Verdict((), (*([problem] * bool(problem)), *inspection.incomplete))


def _checked(job: "Job") -> "tuple[RigCheck, Sequence[str]]":
    """The rig, checked by the whole recording, and what the run could not use of that."""
    from lidcam.cli.printing.rig_check import CheckedRun
    from lidcam.processing import process_recording

    with ExitStack() as stack:
        run = CheckedRun(stack)
        summary = process_recording(job, run)
    return run.check, summary.incomplete


def _print(
    inspection: "Inspection",
    verdict: Verdict,
    outcomes: "Sequence[Outcome]",
    *,
    as_json: bool,
    repaired: bool,
    checked: "RigCheck | None" = None,
) -> None:
    """Print what was found, and end with the verdict."""
    from lidcam.cli.printing.console import print_inspection
    from lidcam.cli.printing.terminal import console, show_json
    from lidcam.inspection import inspection_tree

    out = console()
    if as_json:
        tree = inspection_tree(inspection) | {"requirements": [one.tree() for one in outcomes]} | verdict.tree()
        if checked is not None:
            from lidcam.cli.printing.rig_check import check_tree

            tree |= {"check": check_tree(checked)}
        show_json(out, tree)
    else:
        unmet = sum(bool(one.failure) for one in outcomes)
        not_met = f"{unmet} of {len(outcomes)} requirements not met" if unmet and not inspection.problem else ""
        told = not_met or first_of(verdict.incomplete) or ("every message was copied" if repaired else "")
        print_inspection(out, inspection, told, every_topic=is_verbose())
        if checked is not None:
            from lidcam.cli.printing.rig_check import print_check

            print_check(out, checked)
    verdict.end()


def _repair(recording: "Recording", output: "OutputFile") -> Iterator[str]:
    """Write the readable messages of a recording; yields lines about the file and topics that were not copied."""
    from lidcam.run.summary import loss_records
    from lidcam.writers.mcap.output import write_repaired

    def lost() -> Iterator[dict[str, str]]:
        for record in loss_records(recording.losses):
            values = record | {"file": location(record["file"]).name}
            yield {key: "unknown" if value is None else str(value) for key, value in values.items()}

    channels = [channel for info in recording.topics for channel in info.channels]
    count = write_repaired(output, channels, recording.messages(), lost=lost())
    yield f"wrote {output.path}: {count} messages"
    for info in _unreadable(recording):
        yield f"not copied: {info.topic}, {info.message_count} messages: {info.unreadable}"


def _unreadable(recording: "Recording") -> list["TopicInfo"]:
    return [info for info in recording.topics if info.unreadable and info.message_count]
