"""What `lidcam inspect` does."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lidcam.frames import TimeWindow
from lidcam.inspection import Inspection, inspect_open, inspect_recording, inspection_tree
from lidcam.job import RigSource
from lidcam.outputs.allowed import check_no_input, check_replaced
from lidcam.printing.console import print_inspection
from lidcam.printing.log import remark_log
from lidcam.printing.terminal import console
from lidcam.settings.choice import SettingsChoice
from lidcam.summary import loss_records
from pipeline.core.errors import OutputError
from readers.location import Location, location
from readers.open import open_recording
from readers.recording import ReadOptions, Recording
from readers.rig.rig_file import draft_yaml
from readers.streams.per_sensor import sensor_messages
from writers.mcap.repair import write_repaired
from writers.outputs.errors import output_errors
from writers.outputs.marked_text import marked_yaml
from writers.outputs.transaction import OutputFile, OutputTransaction

__all__ = ["InspectOptions", "run_inspect"]


@dataclass(frozen=True, slots=True)
class InspectOptions:
    """What to look at and what to write.

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
        LidcamError: the recording or the settings are at fault, or an output cannot be written.
    """
    files = [file for file in (options.repair, options.write_rig) if file is not None]
    check_no_input(files, (*options.inputs, *options.read_files))
    remarks: list[str] = []
    check_repaired = check_replaced("repaired", overwrite=options.overwrite)
    check_draft = check_replaced("text", overwrite=options.overwrite)

    def check_old(path: Path) -> None:
        (check_repaired if path == options.repair else check_draft)(path)

    with OutputTransaction(files, check_old=check_old) as outputs:
        if options.repair is None:
            inspection = inspect_recording(options.inputs, options.settings, options.rig)
            check_no_input(files, inspection.files)
            _report(inspection, options)
            remarks += _write_rig(inspection, options, outputs)
        else:
            with (
                open_recording(options.inputs, ReadOptions("full_scan", options.settings.config.limits)) as recorded,
                sensor_messages(recorded) as recording,
            ):
                check_no_input(files, recording.paths)
                inspection = inspect_open(recording, options.settings, options.rig, TimeWindow())
                _report(inspection, options)
                remarks += _write_rig(inspection, options, outputs)
                remarks += _repair(recorded, outputs[options.repair])
    for remark in remarks:  # the files have their names now
        remark_log.info("%s", remark)


def _report(inspection: Inspection, options: InspectOptions) -> None:
    out = console()
    if options.as_json:
        out.print_json(json.dumps(inspection_tree(inspection)))
    else:
        print_inspection(out, inspection)


def _write_rig(inspection: Inspection, options: InspectOptions, outputs: OutputTransaction) -> Iterator[str]:
    if options.write_rig is not None:
        if inspection.draft is None:
            raise OutputError(f"{options.write_rig}: no rig to write: {inspection.problem}")
        with output_errors(options.write_rig):
            outputs[options.write_rig].part.write_text(marked_yaml(draft_yaml(inspection.draft)), encoding="utf-8")
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
    for info in recording.topics:
        if info.unreadable and info.message_count:
            yield f"not copied: {info.topic}, {info.message_count} messages: {info.unreadable}"
