"""The work of `lidcam inspect`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from lidcam.checks.incomplete import damage_lines
from lidcam.commands.verdict import Verdict, first_of
from lidcam.frames import TimeWindow
from lidcam.inspection import Inspection, inspect_open, inspect_recording, inspection_tree
from lidcam.job import RigSource
from lidcam.outputs.allowed import REPAIRED, TEXT, check_no_input, check_replaced
from lidcam.printing.console import print_inspection
from lidcam.printing.folding import show_line
from lidcam.printing.log import remark_log
from lidcam.printing.terminal import console, show_json
from lidcam.report import loss_records
from lidcam.settings.choice import SettingsChoice
from readers.location import Location, location
from readers.open import open_recording
from readers.recording import ReadOptions, Recording, TopicInfo
from readers.streams.per_sensor import sensor_messages
from writers.mcap.repair import write_repaired
from writers.outputs.errors import output_errors
from writers.outputs.marks import marked_yaml
from writers.outputs.transaction import OutputFile, OutputTransaction

__all__ = ["InspectOptions", "run_inspect"]


@dataclass(frozen=True, slots=True)
class InspectOptions:
    """Arguments of an inspection.

    Attributes:
        inputs: The recording.
        settings: Settings, or those among which the recording decides.
        rig: Rig files, if there are any, loaded or by their paths.
        write_rig: Rig file to write.
        repair: MCAP to write, with every message that can be read.
        overwrite: Replace what no earlier run wrote, too.
        as_json: Print JSON.
        read_files: Files that were read for the settings and the rig.
    """

    inputs: tuple[Location, ...]
    settings: SettingsChoice
    rig: RigSource | None = None
    write_rig: Path | None = None
    repair: Path | None = None
    overwrite: bool = False
    as_json: bool = False
    read_files: tuple[Path, ...] = ()


def run_inspect(options: InspectOptions) -> None:
    """Print what is in a recording; write its rig, or what can be read of it, where that is asked for.

    Raises:
        CheckError: lidcam could not process it, and nothing was to be written.
        IncompleteError: it is damaged, or sensors would be left out; where it was repaired, not all of it came over.
        LidcamError: the recording or the settings are at fault, or an output cannot be written.
    """
    files = [file for file in (options.repair, options.write_rig) if file is not None]
    check_no_input(files, (*options.inputs, *options.read_files))
    remarks: list[str] = []
    lost: list[str] = []
    check_old = check_replaced(lambda path: REPAIRED if path == options.repair else TEXT, overwrite=options.overwrite)
    with OutputTransaction(files, check_old=check_old) as outputs:
        if options.repair is None:
            inspection = inspect_recording(options.inputs, options.settings, options.rig)
            check_no_input(files, inspection.files)
            remarks += _write_rig(inspection, options, outputs)
        else:
            with (
                open_recording(options.inputs, ReadOptions("full_scan", options.settings.config.limits)) as recorded,
                sensor_messages(recorded, limits=options.settings.config.limits) as recording,
            ):
                check_no_input(files, recording.paths)
                inspection = inspect_open(recording, options.settings, options.rig, TimeWindow())
                remarks += _write_rig(inspection, options, outputs)
                remarks += _repair(recorded, outputs[options.repair])
                inspection = replace(inspection, losses=recorded.losses)
                lost += [*damage_lines(recorded.losses), *_not_copied(recorded)]
    for remark in remarks:  # the files have their names now
        remark_log.info("%s", remark)
    _report(inspection, _verdict(inspection, options) if options.repair is None else Verdict((), lost), options)


def _verdict(inspection: Inspection, options: InspectOptions) -> Verdict:
    """Of an inspection; one that wrote a rig to start from has not failed."""
    problem = f"lidcam could not process it: {inspection.problem}" if inspection.problem else ""
    if problem and options.write_rig is None:
        return Verdict((f"{', '.join(map(str, inspection.files))}: {problem}",))
    return Verdict((), (*([problem] * bool(problem)), *inspection.incomplete))


def _report(inspection: Inspection, verdict: Verdict, options: InspectOptions) -> None:
    """Print what was found, and end with the verdict."""
    out = console()
    if options.as_json:
        show_json(out, inspection_tree(inspection) | verdict.tree())
    else:
        print_inspection(out, inspection)
        sound = "every message was copied" if options.repair else "sound, and all of its sensors can be used"
        failed = "lidcam could not process it"  # the line before says why
        show_line(out, f"verdict: {failed if verdict.failures else first_of(verdict.incomplete) or sound}")
    verdict.end()


def _write_rig(inspection: Inspection, options: InspectOptions, outputs: OutputTransaction) -> Iterator[str]:
    """Write the rig that was asked for; without one, print what was found and end without any output."""
    if options.write_rig is not None:
        if not inspection.draft:
            _report(inspection, Verdict((f"{options.write_rig}: no rig to write: {inspection.problem}",)), options)
        else:
            text = marked_yaml(inspection.draft)
            with output_errors(options.write_rig):
                outputs[options.write_rig].part.write_text(text, encoding="utf-8")
            yield f"wrote {options.write_rig}"


def _repair(recording: Recording, output: OutputFile) -> Iterator[str]:
    """Write what can be read of a recording; name the topics that cannot be read."""

    def lost() -> Iterator[dict[str, str]]:
        for record in loss_records(recording.losses):
            values = record | {"file": location(record["file"]).name}
            yield {key: "unknown" if value is None else str(value) for key, value in values.items()}

    channels = [channel for info in recording.topics for channel in info.channels]
    count = write_repaired(output, channels, recording.messages(), lost=lost())
    yield f"wrote {output.path}: {count} messages"
    for info in _unreadable(recording):
        yield f"not copied: {info.topic}, {info.message_count} messages: {info.unreadable}"


def _not_copied(recording: Recording) -> Iterator[str]:
    for info in _unreadable(recording):
        yield f"{info.topic}: {info.message_count} messages not copied"


def _unreadable(recording: Recording) -> list[TopicInfo]:
    return [info for info in recording.topics if info.unreadable and info.message_count]
