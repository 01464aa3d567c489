"""What the commands do: open, find the calibration, run, tell. Heavy imports stay here, so that `--help` is instant."""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from lidcam.console import (
    Inspection,
    console,
    inspection_tree,
    loss_records,
    print_detections,
    print_inspection,
    print_matches,
    print_summary,
    summary_tree,
    unused_topics,
)
from lidcam.run import TimeWindow, process
from pipeline.core.errors import CalibrationError, ConfigError, OutputError, RecordingError
from pipeline.core.frame import FrameResult
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import dump_config, load_config
from pipeline.core.settings.run import RunConfig
from readers.location import Location, RemotePath, location
from readers.messages.image import decode_any_image
from readers.open import open_recording
from readers.recording import ReadOptions, Recording
from readers.rig.discovery import Discovery, discover_rig, rig_from_file
from readers.rig.load import load_rig
from readers.rig.rig_file import rig_yaml, write_rig
from readers.streams.decoders import OnBadMessage
from readers.streams.motion import find_motion_source
from readers.streams.per_sensor import sensor_messages
from readers.streams.survey import survey
from writers.base import ResultWriter
from writers.mcap.repair import write_repaired
from writers.mcap.writer import McapResultWriter, Provenance

__all__ = ["InspectOptions", "ProcessOptions", "run_inspect", "run_process"]

logger = logging.getLogger(__name__)

INSPECTED_NS = 5_000_000_000
"""How much of a recording on a server `inspect` looks at: enough for the rate of a topic of 1 Hz."""


@dataclass(frozen=True, slots=True)
class ProcessOptions:
    """The command line of `process`."""

    inputs: tuple[Location, ...]
    output: Path
    rerun: Path | None = None
    config_file: Path | None = None
    overrides: tuple[str, ...] = ()
    rig_file: Path | None = None
    model_2d: Path | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    on_bad_message: OnBadMessage = "skip"
    print_detections: bool = False
    print_matches: bool = False
    as_json: bool = False


@dataclass(frozen=True, slots=True)
class InspectOptions:
    """The command line of `inspect`."""

    inputs: tuple[Location, ...]
    config_file: Path | None = None
    overrides: tuple[str, ...] = ()
    rig_file: Path | None = None
    write_rig: Path | None = None
    repair: Path | None = None
    as_json: bool = False


def run_process(options: ProcessOptions) -> None:
    """Process a recording and print the final table.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    config = _config(options.config_file, options.overrides, model_2d=options.model_2d)
    _check_outputs(options)
    out, err = console(), console(stderr=True)
    reading = ReadOptions("as_needed" if options.on_bad_message == "skip" else "none", config.limits)
    with sensor_messages(open_recording(options.inputs, reading)) as recording:
        for path in dict.fromkeys(loss.path for loss in recording.losses):
            logger.warning("%s is damaged or was not closed: what can still be read is read", path)
        _check_not_empty(recording)
        _check_not_overwritten(recording, options.output, options.rerun)
        window = _window(recording, options)
        found = _find_rig(recording, config, options.rig_file, window)
        for fault in found.faults:
            logger.warning("%s is left out: %s", fault.sensor, fault.reason)
        provenance = Provenance(
            version=version("lidcam"),
            inputs=tuple(_identity(path) for path in recording.paths),
            config_yaml=dump_config(config.model_copy(update={"run": RunConfig()})),  # how it was run changes nothing
            rig_yaml=rig_yaml(found.rig),
            start_ns=recording.start_ns,
        )
        motion = find_motion_source(recording, found.rig, found.transforms, config)
        with ExitStack() as stack:
            writers: list[ResultWriter] = [
                stack.enter_context(McapResultWriter(options.output, found.rig, config, provenance))
            ]
            if options.rerun is not None:
                from writers.rerun.writer import RerunResultWriter  # loads a viewer's worth of code

                decode = partial(decode_any_image, limits=config.limits)
                rerun = RerunResultWriter(options.rerun, found.rig, config, provenance, decode_any_image=decode)
                writers.append(stack.enter_context(rerun))
            with _progress(err, recording, window) as advance:

                def on_result(frame: FrameResult) -> None:
                    advance(frame)
                    if options.print_detections:
                        print_detections(out, frame, config)
                    if options.print_matches:
                        print_matches(out, frame, config)

                summary = process(
                    recording,
                    found.rig,
                    config,
                    writers,
                    motion_source=motion,
                    window=window,
                    on_bad=options.on_bad_message,
                    on_result=on_result,
                    early_drops=found.transforms.drops,
                )
        outputs = [path for path in (options.output, options.rerun) if path is not None]
        report = summary, found, unused_topics(recording, summary), outputs
        if options.as_json:
            out.print_json(json.dumps(summary_tree(*report)))
        else:
            print_summary(out, *report)


def run_inspect(options: InspectOptions) -> None:
    """Print what is in a recording.

    Raises:
        LidcamError: the recording or the settings are at fault, or the rig file cannot be written.
    """
    config = _config(options.config_file, options.overrides)
    for output in (options.write_rig, options.repair):
        if output is not None:
            _check_writable(output)
    out = console()
    reading = ReadOptions("as_needed" if options.repair is None else "full_scan", config.limits)
    with (
        open_recording(options.inputs, reading) as recorded,
        sensor_messages(recorded) as recording,
    ):
        _check_not_empty(recording)
        _check_not_overwritten(recording, options.write_rig, options.repair)
        window = TimeWindow() if options.repair else _inspected(recording)
        topics = survey(recording, stop_ns=window.stop_ns)
        found, problem = _try_find_rig(recording, config, options.rig_file, window)
        motion = find_motion_source(recording, found.rig, found.transforms, config) if found else None
        inspection = Inspection(recording, config, topics, found, motion, problem, window.stop_ns)
        if options.as_json:
            out.print_json(json.dumps(inspection_tree(inspection)))
        else:
            print_inspection(out, inspection)
        if options.write_rig is not None:
            if found is None:
                raise OutputError(f"{options.write_rig}: no rig to write: {problem}")
            write_rig(found.rig, options.write_rig)
            console(stderr=True).print(f"wrote {options.write_rig}")
        if options.repair is not None:
            _repair(recorded, options.repair)


def _repair(recording: Recording, output: Path) -> None:
    """Write what can be read of a recording; of topics that cannot be read, the messages are named as left out."""

    def lost() -> Iterator[dict[str, str]]:
        for record in loss_records(recording.losses):
            values = record | {"file": location(record["file"]).name}
            yield {key: "unknown" if value is None else str(value) for key, value in values.items()}

    channels = [channel for info in recording.topics for channel in info.channels]
    count = write_repaired(output, channels, recording.messages(), lost=lost())
    err = console(stderr=True)
    err.print(f"wrote {output}: {count} messages")
    for info in recording.topics:
        if info.unreadable and info.message_count:
            err.print(f"not copied: {info.topic}, {info.message_count} messages: {info.unreadable}")


def _config(path: Path | None, overrides: tuple[str, ...], model_2d: Path | None = None) -> Config:
    config = load_config(path, overrides)
    if model_2d is None:
        return config
    return config.model_copy(update={"detect2d": config.detect2d.model_copy(update={"model": model_2d})})


def _check_outputs(options: ProcessOptions) -> None:
    for output in (options.output, options.rerun):
        if output is None:
            continue
        _check_writable(output)
        if _is_one_of(options.inputs, output):
            raise OutputError(f"{output}: is the recording itself; choose another name")
    if options.rerun is not None and options.rerun.resolve() == options.output.resolve():
        raise OutputError(f"{options.rerun}: is the same file as {options.output}; choose another name")


def _check_writable(output: Path) -> None:
    if output.is_dir():
        raise OutputError(f"{output}: expected the name of a file to write, found a folder")
    if not output.parent.is_dir():
        raise OutputError(f"{output}: the folder {output.parent} does not exist; create it first")


def _check_not_overwritten(recording: Recording, *outputs: Path | None) -> None:
    """Refuse an output that is a file of the recording: one inside its folder, or one that a link leads to."""
    for output in outputs:
        if output is not None and _is_one_of(recording.paths, output):
            raise OutputError(f"{output}: is a file of the recording itself; choose another name")


def _is_one_of(inputs: Sequence[Location], output: Path) -> bool:
    files = [path for path in inputs if isinstance(path, Path) and path.exists()]
    return output.exists() and any(path.samefile(output) for path in files)


def _check_not_empty(recording: Recording) -> None:
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")


def _find_rig(recording: Recording, config: Config, rig_file: Path | None, window: TimeWindow) -> Discovery:
    start_ns, stop_ns = window.start_ns, window.stop_ns
    if rig_file is None:
        return discover_rig(recording, config, start_ns=start_ns, stop_ns=stop_ns)
    return rig_from_file(load_rig(rig_file), recording, config, start_ns=start_ns, stop_ns=stop_ns)


def _window(recording: Recording, options: ProcessOptions) -> TimeWindow:
    start_ns = recording.start_ns + round(options.start_s * 1e9)
    if start_ns > recording.end_ns:
        seconds = (recording.end_ns - recording.start_ns) / 1e9
        raise ConfigError(f"--start {options.start_s:g}: the recording is only {seconds:.3f} s long")
    stop_ns = None if options.duration_s is None else start_ns + round(options.duration_s * 1e9)
    return TimeWindow(start_ns if options.start_s else None, stop_ns)


def _inspected(recording: Recording) -> TimeWindow:
    """How much of a recording is looked at: of one on a server only the beginning, so as not to fetch all of it."""
    stop_ns = recording.start_ns + INSPECTED_NS
    is_remote = any(isinstance(path, RemotePath) for path in recording.paths)
    return TimeWindow(None, stop_ns if is_remote and stop_ns <= recording.end_ns else None)


def _identity(path: Location) -> dict[str, str]:
    """What tells an input file from others; a file on a server is not fetched as a whole for its checksum."""
    if isinstance(path, RemotePath):
        return {"name": path.name, "url": str(path), **dict(path.facts)}
    with path.open("rb") as file:
        return {"name": path.name, "sha256": file_digest(file, "sha256").hexdigest()}


@contextmanager
def _progress(err: Console, recording: Recording, window: TimeWindow) -> Iterator[Callable[[FrameResult], None]]:
    """Progress over the recorded time, on a terminal only."""
    if not err.is_terminal:
        yield lambda _: None
        return
    start_ns = window.start_ns or recording.start_ns
    stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
    columns = (TextColumn("{task.completed:.1f} of {task.total:.1f} s"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("", total=(stop_ns - start_ns) / 1e9)
        yield lambda frame: progress.update(task, completed=(frame.bundle.log_time_ns - start_ns) / 1e9)


def _try_find_rig(
    recording: Recording, config: Config, rig_file: Path | None, window: TimeWindow
) -> tuple[Discovery | None, str]:
    """The rig, or why there is none: `inspect` tells of a recording that `process` could not use."""
    try:
        return _find_rig(recording, config, rig_file, window), ""
    except (CalibrationError, RecordingError) as err:
        return None, str(err)
