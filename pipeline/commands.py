"""What the commands do: open, find the calibration, run, tell. Heavy imports stay here, so that `--help` is instant."""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from hashlib import file_digest
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from pipeline.build import box_source
from pipeline.config import Config, RunConfig, dump_config, load_config
from pipeline.errors import CalibrationError, ConfigError, OutputError, RecordingError
from pipeline.process import OUTSIDE_ZONES, RunSummary, TimeWindow, process
from pipeline.types import FrameResult
from readers.bag import open_recording
from readers.base import Recording
from readers.discover import Discovery, discover_rig, rig_from_file
from readers.image import decode_picture
from readers.motion import find_motion_source
from readers.rig import load_rig
from readers.rig_file import rig_yaml, write_rig
from readers.sensors import OnBadMessage
from readers.survey import TopicSurvey, survey
from writers.base import ResultWriter
from writers.mcap import McapResultWriter, Provenance
from writers.tables import (
    drops_table,
    objects_table,
    pairs_table,
    points_table,
    sensors_table,
    stages_table,
    topics_table,
)

__all__ = ["InspectOptions", "ProcessOptions", "run_inspect", "run_process"]

logger = logging.getLogger(__name__)

WIDEST = 10_000
"""Columns of a table's line at most: more than any table has."""


@dataclass(frozen=True, slots=True)
class ProcessOptions:
    """The command line of `process`."""

    inputs: tuple[Path, ...]
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

    inputs: tuple[Path, ...]
    config_file: Path | None = None
    overrides: tuple[str, ...] = ()
    rig_file: Path | None = None
    write_rig: Path | None = None
    as_json: bool = False


def run_process(options: ProcessOptions) -> None:
    """Process a recording and print the final table.

    Raises:
        LidcamError: the input, the calibration, the settings or an output is at fault; no output is left behind.
    """
    config = _config(options.config_file, options.overrides, model_2d=options.model_2d)
    _check_outputs(options)
    out, err = _console(), _console(stderr=True)
    with open_recording(options.inputs) as recording:
        _check_not_empty(recording)
        _check_not_overwritten(recording, options.output, options.rerun)
        found = _find_rig(recording, config, options.rig_file)
        for fault in found.faults:
            logger.warning("%s is left out: %s", fault.sensor, fault.reason)
        provenance = Provenance(
            version=version("lidcam"),
            inputs=tuple((path.name, _sha256(path)) for path in recording.paths),
            config_yaml=dump_config(config.model_copy(update={"run": RunConfig()})),  # how it was run changes nothing
            rig_yaml=rig_yaml(found.rig),
            start_ns=recording.start_ns,
        )
        with ExitStack() as stack:
            writers: list[ResultWriter] = [
                stack.enter_context(McapResultWriter(options.output, found.rig, config, provenance))
            ]
            if options.rerun is not None:
                from writers.rerun import RerunResultWriter  # loads a viewer's worth of code

                rerun = RerunResultWriter(options.rerun, found.rig, config, provenance, decode_picture=decode_picture)
                writers.append(stack.enter_context(rerun))
            with _progress(err, recording, options) as advance:

                def on_result(frame: FrameResult) -> None:
                    advance(frame)
                    if options.print_detections:
                        _print_detections(out, frame, config)
                    if options.print_matches:
                        _print_matches(out, frame, config)

                summary = process(
                    recording,
                    found.rig,
                    config,
                    writers,
                    motion_source=find_motion_source(recording, found.rig, found.transforms, config),
                    window=_window(recording, options),
                    on_bad=options.on_bad_message,
                    on_result=on_result,
                    early_drops=found.transforms.drops,
                )
    _print_summary(out, summary, found, options)


def run_inspect(options: InspectOptions) -> None:
    """Print what is in a recording.

    Raises:
        LidcamError: the recording or the settings are at fault, or the rig file cannot be written.
    """
    config = _config(options.config_file, options.overrides)
    if options.write_rig is not None:
        _check_writable(options.write_rig)
    out = _console()
    with open_recording(options.inputs) as recording:
        _check_not_empty(recording)
        _check_not_overwritten(recording, options.write_rig)
        topics = survey(recording)
        found, problem = _try_find_rig(recording, config, options.rig_file)
        if options.as_json:
            out.print_json(json.dumps(_inspection(recording, topics, found, problem, config)))
        else:
            _print_inspection(out, recording, topics, found, problem, config)
        if options.write_rig is not None:
            if found is None:
                raise OutputError(f"{options.write_rig}: no rig to write: {problem}")
            write_rig(found.rig, options.write_rig)
            _console(stderr=True).print(f"wrote {options.write_rig}")


def _config(path: Path | None, overrides: tuple[str, ...], model_2d: Path | None = None) -> Config:
    config = load_config(path, overrides)
    if model_2d is None:
        return config
    return config.model_copy(update={"detect2d": config.detect2d.model_copy(update={"model": model_2d})})


def _console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: names of topics and files may look like markup. Lines are never broken."""
    return Console(stderr=stderr, soft_wrap=True, markup=False, emoji=False)


def _show(out: Console, table: RenderableType) -> None:
    """Print a table as wide as it needs to be, whatever the terminal: no value cut or broken, no trailing blanks."""
    for line in out.render_lines(table, out.options.update(width=WIDEST), pad=False):
        text = Text.assemble(*((segment.text, segment.style or "") for segment in line))
        text.rstrip()
        out.print(text)


def _check_outputs(options: ProcessOptions) -> None:
    for output in (options.output, options.rerun):
        if output is None:
            continue
        _check_writable(output)
        if any(path.exists() and output.exists() and path.samefile(output) for path in options.inputs):
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
        if output is not None and output.exists() and any(path.samefile(output) for path in recording.paths):
            raise OutputError(f"{output}: is a file of the recording itself; choose another name")


def _check_not_empty(recording: Recording) -> None:
    if recording.message_count == 0:
        names = ", ".join(str(path) for path in recording.paths)
        raise RecordingError(f"{names}: the recording has no messages; record it again, or check that it was closed")


def _find_rig(recording: Recording, config: Config, rig_file: Path | None) -> Discovery:
    if rig_file is None:
        return discover_rig(recording, config)
    return rig_from_file(load_rig(rig_file), recording, config)


def _window(recording: Recording, options: ProcessOptions) -> TimeWindow:
    start_ns = recording.start_ns + round(options.start_s * 1e9)
    if start_ns > recording.end_ns:
        seconds = (recording.end_ns - recording.start_ns) / 1e9
        raise ConfigError(f"--start {options.start_s:g}: the recording is only {seconds:.3f} s long")
    stop_ns = None if options.duration_s is None else start_ns + round(options.duration_s * 1e9)
    return TimeWindow(start_ns if options.start_s else None, stop_ns)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def _progress(err: Console, recording: Recording, options: ProcessOptions) -> Iterator[Callable[[FrameResult], None]]:
    """Progress over the recorded time, on a terminal only."""
    if not err.is_terminal:
        yield lambda _: None
        return
    window = _window(recording, options)
    start_ns = window.start_ns or recording.start_ns
    stop_ns = min(window.stop_ns or recording.end_ns, recording.end_ns)
    columns = (TextColumn("{task.completed:.1f} of {task.total:.1f} s"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task("", total=(stop_ns - start_ns) / 1e9)
        yield lambda frame: progress.update(task, completed=(frame.bundle.log_time_ns - start_ns) / 1e9)


def _print_detections(out: Console, frame: FrameResult, config: Config) -> None:
    boxes = frame.lidar_boxes
    out.print(f"frame {frame.bundle.index}  stamp {boxes.stamp_ns} ns  {len(boxes)} lidar detections")
    for row in range(len(boxes)):
        (x, y, z), (length, width, height) = boxes.centers[row], boxes.sizes[row]
        out.print(
            f"  {row:3} {config.class_names[boxes.class_ids[row]]:10} score {boxes.scores[row]:.2f}"
            f"  x {x:8.2f} y {y:8.2f} z {z:6.2f}  l {length:5.2f} w {width:5.2f} h {height:5.2f}"
            f"  yaw {boxes.yaws[row]:6.3f}  {boxes.point_counts[row]} points",
        )


def _print_matches(out: Console, frame: FrameResult, config: Config) -> None:
    out.print(f"frame {frame.bundle.index}  stamp {frame.bundle.stamp_ns} ns  matches")
    matched: set[int] = set()
    for camera, matches in frame.matches.items():
        boxes2d = frame.camera_boxes[camera]
        for (row3d, row2d), iou in zip(matches.pairs.tolist(), matches.iou.tolist(), strict=True):
            name = config.class_names[boxes2d.class_ids[row2d]]
            out.print(f"  {camera}: object {row3d} is 2D box {row2d} ({name}), IoU {iou:.2f}")
            matched.add(row3d)
        alone = sorted(set(range(len(boxes2d))) - set(matches.pairs[:, 1].tolist()))
        if alone:
            out.print(f"  {camera}: seen by the camera alone: {', '.join(map(str, alone))}")
    alone = sorted(set(range(len(frame.lidar_boxes))) - matched)
    out.print(f"  seen by the lidars alone: {', '.join(map(str, alone)) or 'none'}")


def _print_summary(out: Console, summary: RunSummary, found: Discovery, options: ProcessOptions) -> None:
    if options.as_json:
        out.print_json(json.dumps(_summary(summary, found, options)))
        return
    zones = [*(zone.name for zone in found.rig.zones), OUTSIDE_ZONES]
    for fault in found.faults:
        out.print(f"left out: {fault.sensor} ({fault.topic}): {fault.reason}")
    _show(out, objects_table(summary.objects, zones))
    out.print()
    _show(out, drops_table(summary.messages_used, summary.drops.counts, summary.drops.examples))
    for reason, count in summary.boxes_left_out.items():
        out.print(f"  recorded 2D boxes left out: {count}, {reason}")
    out.print()
    _show(out, stages_table(summary.stage_seconds, summary.frames))
    out.print()
    _show(out, points_table(summary.points, summary.frames))
    out.print()
    facts = {
        "frames": f"{summary.frames}, {summary.frames_per_second:.1f} a second",
        "sync skew": f"{summary.skew_mean_ms:.1f} ms mean, {summary.skew_max_ms:.1f} ms at most",
        "2D boxes": _BOX_SOURCES[summary.box_source],
        "confirmed": f"{summary.confirmed} of {sum(summary.objects.values())} objects by a camera",
        "written": ", ".join(str(path) for path in (options.output, options.rerun) if path is not None),
    }
    _show(out, pairs_table("run", facts))


_BOX_SOURCES = {
    "onnx": "from the 2D network",
    "recorded": "as recorded",
    "none": "none: lidar-only (no model given with --model-2d, no boxes recorded)",
}


def _summary(summary: RunSummary, found: Discovery, options: ProcessOptions) -> dict[str, Any]:
    return {
        "frames": summary.frames,
        "frames_per_second": summary.frames_per_second,
        "wall_seconds": summary.wall_seconds,
        "stage_ms": {name: 1e3 * spent / summary.frames for name, spent in summary.stage_seconds.items()},
        "box_source": summary.box_source,
        "objects": [{"class": c, "zone": z, "count": count} for (c, z), count in summary.objects.items()],
        "confirmed": summary.confirmed,
        "points": dict(summary.points),
        "messages_used": dict(summary.messages_used),
        "drops": [
            {
                "topic": topic,
                "reason": reason,
                "count": count,
                "example": summary.drops.examples.get((topic, reason), ""),
            }
            for (topic, reason), count in sorted(summary.drops.counts.items())
        ],
        "boxes_left_out": dict(summary.boxes_left_out),
        "sync_skew_ms": {"mean": summary.skew_mean_ms, "max": summary.skew_max_ms},
        "faults": [asdict(fault) for fault in found.faults],
        "outputs": [str(path) for path in (options.output, options.rerun) if path is not None],
    }


def _try_find_rig(recording: Recording, config: Config, rig_file: Path | None) -> tuple[Discovery | None, str]:
    """The rig, or why there is none: `inspect` tells of a recording that `process` could not use."""
    try:
        return _find_rig(recording, config, rig_file), ""
    except (CalibrationError, RecordingError) as err:
        return None, str(err)


def _inspection(
    recording: Recording, topics: Sequence[TopicSurvey], found: Discovery | None, problem: str, config: Config
) -> dict[str, Any]:
    report: dict[str, Any] = {
        "files": [str(path) for path in recording.paths],
        "start_ns": recording.start_ns,
        "end_ns": recording.end_ns,
        "messages": recording.message_count,
        "topics": [asdict(topic) for topic in topics],
        "problem": problem,
    }
    if found is not None:
        motion = find_motion_source(recording, found.rig, found.transforms, config)
        report |= {
            "site_frame": found.rig.site_frame,
            "sensors": [asdict(source) for source in found.sources],
            "faults": [asdict(fault) for fault in found.faults],
            "notes": list(found.notes),
            "motion": list(motion.topics) if motion else [],
            "box_source": box_source(config, found.rig),
        }
    return report


def _print_inspection(
    out: Console,
    recording: Recording,
    topics: Sequence[TopicSurvey],
    found: Discovery | None,
    problem: str,
    config: Config,
) -> None:
    seconds = (recording.end_ns - recording.start_ns) / 1e9
    files = ", ".join(str(path) for path in recording.paths)
    out.print(f"{files}: {recording.message_count} messages, {seconds:.2f} s")
    out.print()
    _show(out, topics_table(topics))
    if found is None:
        out.print(f"\nlidcam could not process it: {problem}")
        return
    report = _inspection(recording, topics, found, problem, config)
    out.print(f"\nsite frame: {found.rig.site_frame}")
    _show(out, sensors_table(report["sensors"]))
    for fault in found.faults:
        out.print(f"left out: {fault.sensor} ({fault.topic}): {fault.reason}")
    for note in found.notes:
        out.print(f"note: {note}")
    out.print(f"motion of the site frame: {', '.join(report['motion']) or 'none: it stands still'}")
    out.print(f"2D boxes: {_BOX_SOURCES[report['box_source']]}")
