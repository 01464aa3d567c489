"""What a run did: messages used and dropped, objects, points, times. All counting happens here."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from lidcam.box_sources import BoxSource
from lidcam.checks.incomplete import absent_lines, damage_lines, left_out_lines
from lidcam.checks.missing import MissingSensor
from lidcam.checks.warning import RunWarning
from lidcam.settings.choice import UsedSettings
from pipeline.core.detections import Source, source_names
from pipeline.core.errors import MessageError
from pipeline.core.frame import FrameResult
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.messages import Drop
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from readers.input_file import InputFile
from readers.recording import Loss
from readers.rig.calibration import SensorSource
from readers.rig.sensor_topics import SensorFault
from readers.streams.decoders import OnBadMessage

__all__ = [
    "OUTSIDE_ZONES",
    "DropCount",
    "DropTable",
    "RunProgress",
    "RunReport",
    "Tally",
    "UnusedTopic",
    "loss_records",
    "report_tree",
]

OUTSIDE_ZONES = "outside"
"""Name for the place of objects that no zone holds."""


@dataclass(frozen=True, slots=True)
class DropCount:
    """How many messages of one topic, or parts of them, were dropped for one reason.

    Attributes:
        topic: Their topic.
        reason: Why.
        count: How many.
        example: What was found in the first of them; may be empty.
        unit: Whether whole messages were dropped, or parts of messages that were used.
        is_defect: Whether the messages are at fault: they cannot be decoded, or their stamps are no times. The others
            were sound and not needed.
    """

    topic: str
    reason: str
    count: int
    example: str
    unit: Literal["messages", "parts"] = "messages"
    is_defect: bool = False

    @property
    def amount(self) -> str:
        """How many of what."""
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


class DropTable:
    """Dropped messages by topic and reason; memory does not grow with their number.

    Attributes:
        on_bad: What becomes of a message that cannot be decoded.
        total: Number of dropped messages.
    """

    def __init__(self, on_bad: OnBadMessage = "skip") -> None:
        """Count drops; with `on_bad="fail"`, the first bad message ends the run."""
        self.on_bad: OnBadMessage = on_bad
        self.total = 0
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], str] = {}
        self._of_parts: set[tuple[str, str]] = set()
        self._defects: set[tuple[str, str]] = set()

    def add(self, drop: Drop) -> None:
        """Count a message, or parts of one; the first detail of its kind is kept as the example."""
        key = (drop.topic, drop.reason)
        self._counts[key] += drop.parts or 1
        self.total += drop.parts or 1
        if drop.parts:
            self._of_parts.add(key)
        if drop.detail:
            self._examples.setdefault(key, drop.detail)

    def add_defect(self, drop: Drop) -> None:
        """Count a message that is at fault itself."""
        self.add(drop)
        self._defects.add((drop.topic, drop.reason))

    def add_bad(self, drop: Drop) -> None:
        """Count a message that cannot be decoded.

        Raises:
            MessageError: bad messages end the run.
        """
        if self.on_bad == "fail":
            raise MessageError(drop.detail or f"{drop.topic}: {drop.reason}")
        self.add_defect(drop)

    @property
    def rows(self) -> tuple[DropCount, ...]:
        """The counts, by topic and reason."""
        return tuple(
            DropCount(
                *key,
                count,
                self._examples.get(key, ""),
                "parts" if key in self._of_parts else "messages",
                key in self._defects,
            )
            for key, count in sorted(self._counts.items())
        )

    def count(self, topic: str) -> int:
        """Number of dropped messages of one topic."""
        return sum(count for (name, _), count in self._counts.items() if name == topic)


@dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a run is.

    Attributes:
        frames: Number of frames so far.
        objects: Number of fused objects in them.
        drops: Number of messages that were dropped. Reading is ahead of the frames, so this is no exact result.
    """

    frames: int
    objects: int
    drops: int


@dataclass(frozen=True, slots=True)
class RunReport:
    """What a run did. Holds no open file: it can be pickled and sent between processes.

    Attributes:
        inputs: The files that were read.
        frames: Number of frames.
        objects: Number of fused objects by (class name, zone name); the latter is empty where there are no zones.
        sources: Number of fused objects by what their geometry comes from: `lidar`, `camera`, `both`.
        confirmed: Number of fused objects that at least one camera confirms.
        frames_without_boxes: Number of frames for which no camera sent an image or boxes.
        frames_without_boxes3d: Number of frames for which no recorded 3D detector sent boxes; 0 where none is used.
        points: Lidar points by step of the combination, summed over the frames.
        messages_used: Number of messages used, by topic.
        copied: Number of messages copied to the output, by topic.
        drops: Messages that were not used, by topic and reason.
        missing: Sensors without which frames had to do.
        unused_boxes: Recorded 2D boxes that could not be used, by reason.
        unused_boxes3d: Recorded 3D boxes that could not be used, by reason.
        boxes_without_object: 2D boxes without a 3D box that begin no object, by reason.
        objects_left_out: Fused objects that are not reported, by reason.
        unused_topics: Topics with messages that the run did not look at.
        losses: Damaged parts of the files.
        box_source: Where 2D boxes came from.
        box_source_3d: Where the lidars' 3D boxes came from: a name of `ENGINES`.
        motion_topics: Where the motion of the site frame came from; empty where it stands still.
        compensated: Frames with a cloud that was moved to the frame's time.
        skew_mean_ms: Mean spread of the stamps in a bundle.
        skew_max_ms: Largest spread.
        settings: Which settings were used, and why these.
        settings_sha256: Checksum of all of them that affect the result.
        rig: The sensors, with their calibration and the zones.
        sensors: Where the calibration of each sensor was found.
        faults: Sensors that were left out, and why.
        notes: Remarks on topics and sensors.
        warnings: What makes the result doubtful.
        outputs: Files that were written.
        how_to_open: How the outputs are opened, by the name of the viewer.
        stage_seconds: Time spent per stage, summed over the frames and over all processes that shared them.
        wall_seconds: For loading the stages, and from the first message to the last result.
    """

    inputs: tuple[InputFile, ...]
    frames: int
    objects: Mapping[tuple[str, str], int]
    sources: Mapping[str, int]
    confirmed: int
    frames_without_boxes: int
    frames_without_boxes3d: int
    points: Mapping[str, int]
    messages_used: Mapping[str, int]
    copied: Mapping[str, int]
    drops: tuple[DropCount, ...]
    missing: tuple[MissingSensor, ...]
    unused_boxes: Mapping[str, int]
    unused_boxes3d: Mapping[str, int]
    boxes_without_object: Mapping[str, int]
    objects_left_out: Mapping[str, int]
    unused_topics: tuple[UnusedTopic, ...]
    losses: tuple[Loss, ...]
    box_source: BoxSource
    box_source_3d: str
    motion_topics: tuple[str, ...]
    compensated: int
    skew_mean_ms: float
    skew_max_ms: float
    settings: UsedSettings
    settings_sha256: str
    rig: Rig
    sensors: tuple[SensorSource, ...]
    faults: tuple[SensorFault, ...]
    notes: tuple[str, ...]
    warnings: tuple[RunWarning, ...]
    outputs: tuple[Path, ...]
    how_to_open: Mapping[str, str]
    stage_seconds: Mapping[str, float]
    wall_seconds: float

    @property
    def incomplete(self) -> tuple[str, ...]:
        """What of the recording could not be used, one short line each; empty if nothing is missing.

        Sensors that were left out or are in no frame, messages that are at fault, messages lost to damage. Drops of
        synchronisation and pauses of a sensor are not among them.
        """
        defects = (drop for drop in self.drops if drop.is_defect)
        return (
            *left_out_lines(self.faults),
            *absent_lines(self.missing),
            *(f"{drop.topic}: {drop.amount} dropped: {drop.reason}" for drop in defects),
            *damage_lines(self.losses),
        )

    @property
    def frames_per_second(self) -> float:
        """Frames by wall time."""
        return self.frames / self.wall_seconds if self.wall_seconds else 0.0


class Tally:
    """Running totals over the frames of a run."""

    def __init__(self, config: Config, rig: Rig) -> None:
        self._class_names = config.object_names
        self._zones = rig.counted_zones
        self._detectors = frozenset(detector.topic for detector in rig.detectors)
        self.frames = 0
        self.sources = Counter({source.name.lower(): 0 for source in Source})
        self.confirmed = 0
        self.frames_without_boxes = 0
        self.frames_without_boxes3d = 0
        self.compensated = 0
        self.objects: Counter[tuple[str, str]] = Counter()
        self.points: Counter[str] = Counter()
        self.messages: Counter[str] = Counter()
        self.copied: Counter[str] = Counter()
        self.unused_boxes: Counter[str] = Counter()
        self.unused_boxes3d: Counter[str] = Counter()
        self.boxes_without_object: Counter[str] = Counter()
        self.objects_left_out: Counter[str] = Counter()

    def add(self, frame: FrameResult) -> None:
        """Count one frame."""
        objects = frame.fused.objects
        self.frames += 1
        self.compensated += bool(frame.combined.compensated)
        self.sources.update(source_names(objects.sources))
        self.confirmed += int((frame.fused.matched > 0).sum())
        self.frames_without_boxes += not frame.detections.cameras
        self.frames_without_boxes3d += bool(self._detectors) and self._detectors.isdisjoint(frame.bundle.messages)
        rows = first_polygon_with([zone.polygon_site for zone in self._zones], objects.centers[:, :2])
        outside = OUTSIDE_ZONES if self._zones else ""
        for class_id, row in zip(objects.class_ids.tolist(), rows.tolist(), strict=True):
            zone = self._zones[row].name if row >= 0 else outside
            self.objects[self._class_names[class_id], zone] += 1
        for total, found in (
            (self.points, frame.combined.counts),
            (self.unused_boxes, frame.unused_boxes),
            (self.boxes_without_object, frame.hypotheses.boxes_without_object),
            (self.objects_left_out, frame.fused.left_out),
            (self.unused_boxes3d, frame.unused_boxes3d),
        ):
            for name, count in found.items():
                total[name] += count
        self.copied.update(message.topic for message in frame.bundle.copied)
        unused = {(drop.topic, drop.stamp_ns) for drop in frame.drops if not drop.parts}
        self.messages.update(topic for topic, m in frame.bundle.messages.items() if (topic, m.stamp_ns) not in unused)


def loss_records(losses: Sequence[Loss]) -> list[dict[str, Any]]:
    """Damaged parts for machines: `file`, `position` and `size` in bytes, `messages`, `reason`; None is unknown."""
    return [
        {
            "file": str(loss.path),
            "position": loss.position,
            "size": loss.size,
            "messages": loss.messages,
            "reason": loss.reason,
        }
        for loss in losses
    ]


def report_tree(report: RunReport) -> dict[str, Any]:
    """The report of a run as plain values, for JSON, without what `lidcam.commands.envelope` puts around it."""
    return {
        "frames": report.frames,
        "sync": {"skew_mean_ms": report.skew_mean_ms, "skew_max_ms": report.skew_max_ms},
        "timing": {
            "wall_s": report.wall_seconds,
            "frames_per_second": report.frames_per_second,
            "stage_ms": {name: 1e3 * spent / report.frames for name, spent in report.stage_seconds.items()},
        },
        "box_source": report.box_source,
        "box_source_3d": report.box_source_3d,
        "boxes3d_topics": [detector.topic for detector in report.rig.detectors],
        "motion": {"topics": list(report.motion_topics), "compensated_frames": report.compensated},
        "objects": [{"class": c, "zone": z or None, "count": count} for (c, z), count in report.objects.items()],
        "object_sources": dict(report.sources),
        "confirmed": report.confirmed,
        "frames_without_boxes": report.frames_without_boxes,
        "frames_without_boxes3d": report.frames_without_boxes3d,
        "points": dict(report.points),
        "messages_used": dict(report.messages_used),
        "copied": dict(report.copied),
        "drops": [asdict(drop) for drop in report.drops],
        "missing": [asdict(sensor) for sensor in report.missing],
        "losses": loss_records(report.losses),
        "unused_topics": {topic.topic: topic.message_count for topic in report.unused_topics},
        "unused_boxes": dict(report.unused_boxes),
        "unused_boxes3d": dict(report.unused_boxes3d),
        "boxes_without_object": dict(report.boxes_without_object),
        "objects_left_out": dict(report.objects_left_out),
        "faults": [asdict(fault) for fault in report.faults],
        "outputs": [str(path) for path in report.outputs],
    }
