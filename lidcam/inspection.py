"""The contents of a recording, and what lidcam would use of them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from lidcam.checks.calibration.first_clouds import FirstClouds
from lidcam.checks.clocks import clock_notes, sync_warnings
from lidcam.checks.messages import check_not_empty
from lidcam.evaluation.figures import NamedFigures
from lidcam.pipeline.core.errors import CalibrationError, LidcamError, RecordingError, short_memory_told
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.readers.location import Location, RemotePath
from lidcam.readers.open import open_recording
from lidcam.readers.recording import Loss, ReadOptions, Recording
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.rig.discovery import Discovery, calibrated_rig
from lidcam.readers.rig.draft import draft_yaml
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.search import FoundSensors, find_sensors
from lidcam.readers.rig.sensor_topics import SensorFault
from lidcam.readers.streams.per_sensor import sensor_messages
from lidcam.readers.streams.survey import TopicSurvey, survey
from lidcam.run.box_sources import BoxSource, KnownBoxes, box_source, boxes_2d_words, check_box_source, engine_3d
from lidcam.run.choice import SettingsChoice, UsedSettings, use_settings, used_record
from lidcam.run.frames import RunInput, TimeWindow, missing_from_frames, no_frames, sensor_clocks, synchronize_stamps
from lidcam.run.job import RigSource, read_rig
from lidcam.run.missing import MissingSensor
from lidcam.run.scene import find_motion, on_level_site
from lidcam.run.summary import DropCount, incomplete_lines, loss_records
from lidcam.run.tally import DropTable
from lidcam.run.warning import RunWarning

INSPECTED_NS = 5_000_000_000
"""Examined part of a recording on a server: enough for the rate of a topic of 1 Hz."""


TOPIC_FIGURES = ("count", "rate_hz", "gaps", "longest_gap_s", "delay_s", "backwards")
"""Figures of a topic: fields of `TopicSurvey`."""


@dataclass(frozen=True, slots=True)
class Inspection:
    """The contents of a recording. Holds no open file.

    Attributes:
        files: Its files.
        start_ns: Log time of the first message.
        end_ns: Log time of the last message.
        messages: Number of messages.
        topics: Topics with rates, gaps and delays.
        losses: Damaged parts of the files.
        stop_ns: Log time at which the examined part ends; None: the whole recording was examined.
        problem: Why lidcam cannot process it; empty if it can.
        rig: The sensors that lidcam would use; None if it cannot process the recording.
        draft: Text of a rig file with all sensors, also those without calibration; empty without sensors.
        sensors: Source of the calibration of each sensor.
        faults: Sensors that would be left out, with the reasons.
        missing: Sensors that would be missing from frames.
        drops: Messages that synchronisation would drop.
        sync: Frames that they would make; None if it cannot process the recording.
        notes: Remarks on topics and sensors.
        warnings: What stamps say of clocks and silence, and reasons in the first messages to doubt the calibration.
        motion_topics: Topics of the motion of the site frame; empty where it stands still.
        box_source: Source of the 2D boxes.
        box_words: The same in words, and what to type where cameras lack a network.
        box_source_3d: Source of the lidars' 3D boxes: a name of `ENGINES`.
        settings: The settings that would be used, and why; None if it cannot process the recording.
    """

    files: tuple[Location, ...]
    start_ns: int
    end_ns: int
    messages: int
    topics: tuple[TopicSurvey, ...]
    losses: tuple[Loss, ...]
    stop_ns: int | None = None
    problem: str = ""
    rig: Rig | None = None
    draft: str = ""
    sensors: tuple[SensorSource, ...] = ()
    faults: tuple[SensorFault, ...] = ()
    missing: tuple[MissingSensor, ...] = ()
    drops: tuple[DropCount, ...] = ()
    sync: SyncStats | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[RunWarning, ...] = ()
    motion_topics: tuple[str, ...] = ()
    box_source: BoxSource = "none"
    box_words: tuple[str, str] = ("", "")
    box_source_3d: str = "none"
    settings: UsedSettings | None = None

    __repr__ = brief

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Parts that lidcam could not use, one short line each, as a run would say."""
        return tuple(incomplete_lines(self.faults, self.missing, self.drops, self.losses))

    @property
    def figures(self) -> NamedFigures:
        """Figures by name, such as `topics./points.rate_hz`, of which requirements can be made."""
        sync = self.sync or SyncStats()
        lidars, cameras = (self.rig.lidars, self.rig.cameras) if self.rig else ((), ())
        usable = dict.fromkeys((*(one.name for one in lidars), *(one.name for one in cameras)), 1)
        left_out = {fault.sensor: 0 for fault in self.faults if fault.sensor not in usable}
        return NamedFigures(
            {
                "duration_s": (self.end_ns - self.start_ns) / 1e9,
                "messages": self.messages,
                "damaged_parts": len(self.losses),
                "lidars": len(lidars),
                "cameras": len(cameras),
                "motion_topics": len(self.motion_topics),
                "sensors_left_out": len(self.faults),
                "sensors_missing": len(self.missing),
                "warnings": len(self.warnings),
                "dropped_messages": sum(drop.count for drop in self.drops if drop.unit == "messages"),
                "frames": sync.sets,
                "skew_mean_ms": sync.skew_mean_ns / 1e6 if sync.sets else None,
                "skew_max_ms": sync.skew_max_ns / 1e6 if sync.sets else None,
                "sensors": {name: {"usable": is_usable} for name, is_usable in (usable | left_out).items()},
                "topics": {one.topic: {name: getattr(one, name) for name in TOPIC_FIGURES} for one in self.topics},
            }
        )


def inspect_recording(inputs: Sequence[Location], choice: SettingsChoice, rig: RigSource | None = None) -> Inspection:
    """The contents of a recording, and what lidcam would use of them.

    Only the beginning of a recording on a server is examined.

    Raises:
        CalibrationError: a rig file cannot be read, or does not fit.
        RecordingError: it cannot be opened or is empty.
    """
    limits = choice.config.limits
    with (
        short_memory_told(f"inspect {', '.join(map(str, inputs))}"),
        sensor_messages(open_recording(inputs, ReadOptions(limits=limits)), limits=limits) as recording,
    ):
        return inspect_open(recording, choice, rig, _window(recording))


def inspect_open(recording: Recording, choice: SettingsChoice, rig: RigSource | None, window: TimeWindow) -> Inspection:
    """Inspect an open recording with one topic per sensor; see `inspect_recording`."""
    rig_file, config = read_rig(rig), choice.config
    check_not_empty(recording)
    inspection = Inspection(
        files=recording.paths,
        start_ns=recording.start_ns,
        end_ns=recording.end_ns,
        messages=recording.message_count,
        topics=(),
        losses=(),
        stop_ns=window.stop_ns,
    )
    look = partial(survey, recording, stop_ns=window.stop_ns, limits=config.limits)
    sensors = list[FoundSensors]()

    def discover(rig: RigFile | None) -> Discovery:
        sensors.append(find_sensors(recording, config, rig, start_ns=window.start_ns, stop_ns=window.stop_ns))
        return calibrated_rig(sensors[-1])

    try:
        found = on_level_site(discover(rig_file), recording, config, rig_file, discover)
    except (CalibrationError, RecordingError) as err:
        topics, draft = look(), draft_yaml(sensors[-1], sensors[-1].zones) if sensors else ""
        return replace(inspection, topics=topics, losses=recording.losses, problem=_said(err, recording), draft=draft)
    motion, found = find_motion(recording, config, found)
    config, used, found = use_settings(choice, recording, found, rig_file, moves=motion is not None)
    source = RunInput(recording, found.rig, config, window=window)
    drops, stats = DropTable("skip"), SyncStats()
    clocks = sensor_clocks(found.rig, motion, drops)
    topics = look(watch=partial(synchronize_stamps, source, drops, stats, clocks))
    missing = missing_from_frames(source, stats)
    cannot = "" if stats.sets or window.stop_ns is not None else no_frames(source, drops)
    return replace(
        inspection,
        topics=topics,
        problem=_said(cannot or _unusable_network(choice.config, source), recording),
        missing=tuple(missing),
        drops=drops.rows,
        sync=stats,
        rig=found.rig,
        draft=draft_yaml(sensors[-1], found.rig.zones),
        sensors=found.sources,
        faults=found.faults,
        notes=(*found.notes, *clock_notes(clocks, found.rig.sensor_of_topic)),
        warnings=(
            *sync_warnings(clocks, stats, missing, drops.rows, source),
            *_warnings(recording, found.rig, config, window),
        ),
        motion_topics=motion.topics if motion else (),
        box_source=box_source(config, found.rig),
        box_words=boxes_2d_words(config, found.rig),
        box_source_3d=engine_3d(config),
        settings=used,
        losses=recording.losses,
    )


def _unusable_network(named: Config, source: RunInput) -> object:
    """Why the networks, the device or the 2D boxes that the caller names cannot be used; empty if they can."""
    sections = named.detect2d, named.detect3d
    is_named = any(isinstance(section.model, Path) or section.provider == "cuda" for section in sections)
    if not is_named and named.detect2d.method == "auto":
        return ""
    from lidcam.run.build import build_graph  # loads the networks

    try:
        build_graph(source.config, source.rig, KnownBoxes(), on_bad="skip")
        check_box_source(source.config, source.recording, source.rig)
    except LidcamError as err:
        return err
    return ""


def _said(problem: object, recording: Recording) -> str:
    """A problem without the names of the files, which stand beside it."""
    return str(problem).removeprefix(f"{', '.join(map(str, recording.paths))}: ")


def inspection_tree(inspection: Inspection) -> dict[str, Any]:
    """The contents of a recording as plain values, for JSON."""
    tree: dict[str, Any] = {
        "files": [str(path) for path in inspection.files],
        "start_ns": inspection.start_ns,
        "end_ns": inspection.end_ns,
        "messages": inspection.messages,
        "topics": [asdict(topic) for topic in inspection.topics],
        "losses": loss_records(inspection.losses),
        "problem": inspection.problem,
        "looked_at_until_ns": inspection.stop_ns,
        "figures": inspection.figures.tree,
    }
    if inspection.rig is not None:
        tree |= {
            "site_frame": inspection.rig.site_frame,
            "sensors": [asdict(source) for source in inspection.sensors],
            "faults": [asdict(fault) for fault in inspection.faults],
            "notes": list(inspection.notes),
            "warnings": [asdict(warning) for warning in inspection.warnings],
            "motion": list(inspection.motion_topics),
            "box_source": inspection.box_source,
            "box_source_3d": inspection.box_source_3d,
            "boxes3d_topics": [detector.topic for detector in inspection.rig.detectors],
            "settings": used_record(inspection.settings) if inspection.settings else None,
        }
    return tree


def _warnings(recording: Recording, rig: Rig, config: Config, window: TimeWindow) -> tuple[RunWarning, ...]:
    """Warnings of calibration that the first message of each lidar contradicts."""
    clouds = FirstClouds(rig, config)
    for lidar in rig.lidars:
        messages = recording.messages([lidar.topic], start_ns=window.start_ns, stop_ns=window.stop_ns)
        clouds.add_messages(islice(messages, 1))
    return clouds.lidar_warnings or clouds.camera_warnings


def _window(recording: Recording) -> TimeWindow:
    stop_ns = recording.start_ns + INSPECTED_NS
    is_remote = any(isinstance(path, RemotePath) for path in recording.paths)
    return TimeWindow(None, stop_ns if is_remote and stop_ns <= recording.end_ns else None)
