"""The summary of a run, in groups."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from lidcam.pipeline.core.rig import CameraFit, Rig
from lidcam.pipeline.core.text import brief
from lidcam.pipeline.evaluation.road_users import RoadUsers
from lidcam.readers.input_file import InputFile
from lidcam.readers.location import RemotePath
from lidcam.readers.messages.tf import TF_TYPES
from lidcam.readers.recording import Loss, Recording
from lidcam.readers.rig.calibration import SensorSource
from lidcam.readers.rig.sensor_topics import CAMERA_INFO, SensorFault
from lidcam.run.box_sources import BoxSource
from lidcam.run.choice import UsedSettings
from lidcam.run.missing import MissingSensor, absent_lines, changed_lines, damage_lines
from lidcam.run.warning import RunWarning


@dataclass(frozen=True, slots=True)
class DropCount:
    """Messages of one topic, or parts of them, that were dropped for one reason.

    Attributes:
        topic: Their topic.
        reason: The reason.
        count: Their number.
        example: The finding in the first of them; may be empty.
        unit: Whether whole messages were dropped, or parts of messages that were used.
        is_defect: Whether the messages are at fault: they cannot be decoded, or their stamps are invalid. Others were
            sound and not needed.
    """

    topic: str
    reason: str
    count: int
    example: str
    unit: Literal["messages", "parts"] = "messages"
    is_defect: bool = False

    @property
    def amount(self) -> str:
        """The count with its unit."""
        return f"{self.count} {self.unit if self.count != 1 else self.unit.removesuffix('s')}"


@dataclass(frozen=True, slots=True)
class UnusedTopic:
    """A topic with messages that a run did not use: neither as data, nor as motion, nor as calibration.

    Attributes:
        topic: Its name.
        message_count: Number of its messages.
        problem: Why it cannot be read; empty if it can.
    """

    topic: str
    message_count: int
    problem: str


def unused_topics(recording: Recording, used: Collection[str]) -> tuple[UnusedTopic, ...]:
    """The topics with messages that were not used, except calibration and transforms."""
    return tuple(
        UnusedTopic(info.topic, info.message_count, info.unreadable)
        for info in recording.topics
        if info.message_count and info.topic not in used and info.msgtype not in CAMERA_INFO | TF_TYPES
    )


@dataclass(frozen=True, slots=True)
class InputSummary:
    """The files and messages that were read."""

    files: tuple[InputFile, ...]  # The files that were read
    changed: tuple[str, ...]  # Files that changed while they were read, including those that the settings name
    messages_used: Mapping[str, int]  # Number of messages used, by topic
    copied: Mapping[str, int]  # Number of messages copied to the output, by topic
    unused_topics: tuple[UnusedTopic, ...]  # Topics with messages that the run did not look at
    losses: tuple[Loss, ...]  # Damaged parts of the files

    __repr__ = brief


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """Counts over the frames."""

    count: int  # Number of frames
    # Fused objects by (class name, zone name); the zone is empty where there are none
    objects: Mapping[tuple[str, str], int]
    # Fused objects by source of their geometry: `lidar`, `camera`, `both`, with tracks also `predicted`
    sources: Mapping[str, int]
    confirmed: int  # Fused objects that at least one camera confirms
    without_boxes: int  # Frames without an image or boxes of any camera
    without_boxes3d: int  # Frames without boxes of recorded 3D detectors; 0 where none is used
    compensated: int  # Frames with a cloud that was moved to the frame's time
    odometry: int  # Frames whose pose, for tracks, comes from the clouds or is corrected by them; 0 for a static rig
    odometry_predicted: int  # Those in which the cloud could not be registered
    points: Mapping[str, int]  # Lidar points by step of the combination, summed over the frames
    skew_mean_ms: float  # Mean spread of the stamps in a frame
    skew_max_ms: float  # Largest spread of the stamps in a frame

    __repr__ = brief


@dataclass(frozen=True, slots=True)
class DropSummary:
    """Counts of what was not used or not reported, by reason."""

    messages: tuple[DropCount, ...]  # Messages, and parts of messages, by topic and reason
    boxes: Mapping[str, int]  # Recorded 2D boxes that could not be used
    boxes3d: Mapping[str, int]  # Recorded 3D boxes that could not be used
    boxes_without_object: Mapping[str, int]  # 2D boxes that neither match a 3D box nor propose an object
    objects: Mapping[str, int]  # Fused objects that are not reported

    __repr__ = brief


@dataclass(frozen=True, slots=True)
class CameraCorrection:
    """Errors of a camera by which a run corrected its recorded calibration, with their standard deviations."""

    turned_deg: float  # Angle by which it was turned
    turned_sigma_deg: float
    late_ms: float  # Delay of its images against their stamps
    late_sigma_ms: float
    zoom: float  # Factor on its focal lengths

    @property
    def is_seen(self) -> bool:
        """Whether it is more than a hundredth of a degree or a millisecond, rounded."""
        return self.turned_deg >= 0.005 or abs(self.late_ms) >= 0.5 or self.zoom != 1

    @classmethod
    def of(cls, fit: CameraFit) -> Self:
        """The correction of a fit."""
        values = np.array(fit.corrected)
        turned = np.degrees([float(np.linalg.norm(values[:3])), fit.direction_sigma_rad])
        late = 1e3 * np.array([values[6], fit.delay_sigma_s])
        return cls(*(round(float(value), 3) for value in (*turned, *late, fit.zoom)))


def camera_corrections(rig: Rig) -> dict[str, CameraCorrection]:
    """The corrections of the cameras of a rig that are more than the figures show, by name."""
    corrections = {one.name: CameraCorrection.of(one.fit) for one in rig.cameras if one.fit.is_changed}
    return {name: one for name, one in corrections.items() if one.is_seen}


@dataclass(frozen=True, slots=True)
class SensorSummary:
    """The sensors, and the sources of boxes and motion."""

    rig: Rig  # The sensors, with their calibration and the zones
    calibration: tuple[SensorSource, ...]  # The source of the calibration of each sensor
    faults: tuple[SensorFault, ...]  # Sensors that were left out, with the reasons
    missing: tuple[MissingSensor, ...]  # Sensors that are missing from frames
    box_source: BoxSource  # Source of the 2D boxes
    box_source_3d: str  # Source of the lidars' 3D boxes: a name of `ENGINES`
    motion_topics: tuple[str, ...]  # Topics of the motion of the site frame; empty where it stands still
    corrections: Mapping[str, CameraCorrection]  # Corrections of cameras by the recording, by name
    box_words: tuple[str, str]  # The source of the 2D boxes in words, and what to type for one: `boxes_2d_words`

    __repr__ = brief


@dataclass(frozen=True, slots=True)
class TimingSummary:
    """Times of a run; no stages and NaN for one that was read back from its result."""

    stage_seconds: Mapping[str, float]  # Time per stage, summed over the frames and over all processes
    wall_seconds: float  # Time to load the stages, and from the first message to the last result
    frames_per_second: float  # Frames per second of wall time


@dataclass(frozen=True, slots=True)
class RunSummary:
    """Report of a run. Holds no open file: it can be pickled and sent between processes.

    Attributes:
        inputs: Files and messages.
        frames: Counts over the frames.
        drops: Messages, boxes and objects that were not used.
        sensors: The sensors.
        timing: Times.
        settings: The settings that were used, and why.
        settings_sha256: Checksum of the settings that affect the result.
        notes: Remarks on topics and sensors.
        warnings: Reasons to doubt the result.
        outputs: Local files that were written.
        how_to_open: Instructions to open the outputs, by the name of the viewer.
        road_users: Road users, each track once; None where nothing is tracked.
        sent: Outputs that were sent to a server.
    """

    inputs: InputSummary
    frames: FrameSummary
    drops: DropSummary
    sensors: SensorSummary
    timing: TimingSummary
    settings: UsedSettings
    settings_sha256: str
    notes: tuple[str, ...]
    warnings: tuple[RunWarning, ...]
    outputs: tuple[Path, ...]
    how_to_open: Mapping[str, str]
    road_users: RoadUsers | None = None
    sent: tuple[RemotePath, ...] = ()

    __repr__ = brief

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Parts of the recording that could not be used, one short line each; empty if nothing is missing.

        Sensors that were left out or are in no frame, faulty messages, messages lost to damage, files that changed
        while they were read. Drops of synchronisation and pauses of a sensor are not among them.
        """
        sensors, inputs = self.sensors, self.inputs
        return (
            *incomplete_lines(sensors.faults, sensors.missing, self.drops.messages, inputs.losses),
            *changed_lines(inputs.changed),
        )


def incomplete_lines(
    faults: Sequence[SensorFault], missing: Sequence[MissingSensor], drops: Sequence[DropCount], losses: Sequence[Loss]
) -> Iterator[str]:
    """The lines of a verdict on a run or an inspection: sensors left out or in no frame, faulty and lost messages."""
    yield from (f"{fault.subject} is left out" for fault in faults)
    yield from absent_lines(missing, dropped_by_topic(drops))
    yield from (f"{drop.topic}: {drop.amount} dropped: {drop.reason}" for drop in drops if drop.is_defect)
    yield from damage_lines(losses)


def dropped_by_topic(drops: Sequence[DropCount]) -> Counter[str]:
    """Number of dropped messages by topic."""
    counts = Counter[str]()
    for drop in drops:
        counts[drop.topic] += drop.count if drop.unit == "messages" else 0
    return counts


def loss_records(losses: Sequence[Loss]) -> list[dict[str, Any]]:
    """Damaged parts for machines: `file`, `position` and `size` in bytes, `messages`, `reason`; None is unknown."""
    keys = ("position", "size", "messages", "reason")
    return [{"file": str(loss.path), **{key: getattr(loss, key) for key in keys}} for loss in losses]


def summary_tree(run: RunSummary) -> dict[str, Any]:
    """The summary of a run as plain values, for JSON."""
    inputs, frames, drops, sensors, timing = run.inputs, run.frames, run.drops, run.sensors, run.timing
    return {
        "frames": frames.count,
        "sync": {"skew_mean_ms": frames.skew_mean_ms, "skew_max_ms": frames.skew_max_ms},
        "timing": {
            "wall_s": timing.wall_seconds,
            "frames_per_second": timing.frames_per_second,
            "stage_ms": {name: 1e3 * spent / frames.count for name, spent in timing.stage_seconds.items()},
        },
        "box_source": sensors.box_source,
        "box_source_3d": sensors.box_source_3d,
        "camera_corrections": {name: asdict(one) for name, one in sensors.corrections.items()},
        "boxes3d_topics": [detector.topic for detector in sensors.rig.detectors],
        "motion": {
            "topics": list(sensors.motion_topics),
            "compensated_frames": frames.compensated,
            "frames_from_clouds": frames.odometry,
            "frames_predicted": frames.odometry_predicted,
        },
        "road_users": _road_users_tree(run.road_users),
        "objects": [{"class": c, "zone": z or None, "count": count} for (c, z), count in frames.objects.items()],
        "object_sources": dict(frames.sources),
        "confirmed": frames.confirmed,
        "frames_without_boxes": frames.without_boxes,
        "frames_without_boxes3d": frames.without_boxes3d,
        "points": dict(frames.points),
        "messages_used": dict(inputs.messages_used),
        "copied": dict(inputs.copied),
        "drops": [asdict(drop) for drop in drops.messages],
        "missing": [asdict(sensor) for sensor in sensors.missing],
        "losses": loss_records(inputs.losses),
        "unused_topics": {topic.topic: topic.message_count for topic in inputs.unused_topics},
        "unused_boxes": dict(drops.boxes),
        "unused_boxes3d": dict(drops.boxes3d),
        "boxes_without_object": dict(drops.boxes_without_object),
        "objects_left_out": dict(drops.objects),
        "faults": [asdict(fault) for fault in sensors.faults],
        "outputs": [str(place) for place in (*run.outputs, *run.sent)],
    }


def _known(row: dict[str, Any]) -> dict[str, Any]:
    """A row of a table for JSON, which has null where a number is not known."""
    return {name: None if value != value else value for name, value in row.items()}


def _road_users_tree(users: RoadUsers | None) -> dict[str, Any] | None:
    """`counts` by class and zone (null: all of the site), `changes` from zone to zone; speeds may be null."""
    if users is None:
        return None
    counts = [_known(asdict(one)) | {"zone": one.zone or None} for one in users.counts]
    changes = [_known(asdict(one)) for one in users.changes]
    return {
        name: [{"class": row.pop("class_name"), **row} for row in rows]
        for name, rows in (("counts", counts), ("changes", changes))
    }
