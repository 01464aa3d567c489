"""Counts during a run: messages used and dropped, objects, points."""

from collections import Counter
from dataclasses import dataclass

from lidcam.pipeline.core.detections import Source, source_names
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.road_users import RoadUserTally
from lidcam.pipeline.stages.sync.synchronize import SyncStats
from lidcam.readers.streams.decoders import OnBadMessage
from lidcam.run.summary import DropCount, DropSummary, FrameSummary


class DropTable:
    """Dropped messages by topic and reason; memory does not grow with their number.

    Attributes:
        on_bad: Whether a message that cannot be decoded is skipped or ends the run.
        total: Number of dropped messages.
    """

    def __init__(self, on_bad: OnBadMessage = "skip") -> None:
        self.on_bad: OnBadMessage = on_bad
        self.total = 0
        self._counts: dict[tuple[str, str], DropCount] = {}

    def count_drop(self, drop: Drop, *, is_defect: bool = False) -> None:
        """Count a message, or parts of one; the first detail of its kind is kept as the example."""
        key, count = (drop.topic, drop.reason), drop.parts or 1
        self.total += count
        known = self._counts.get(key, DropCount(*key, 0, ""))
        self._counts[key] = DropCount(
            *key,
            known.count + count,
            known.example or drop.detail,
            "parts" if drop.parts else known.unit,
            known.is_defect or is_defect,
        )

    def count_defect(self, drop: Drop) -> None:
        """Count a message that is at fault itself."""
        self.count_drop(drop, is_defect=True)

    def count_bad(self, drop: Drop) -> None:
        """Count a message that cannot be decoded; raises MessageError if that ends the run."""
        if self.on_bad == "fail":
            raise MessageError(drop.detail or f"{drop.topic}: {drop.reason}")
        self.count_defect(drop)

    @property
    def rows(self) -> tuple[DropCount, ...]:
        """The counts, by topic and reason."""
        return tuple(count for _, count in sorted(self._counts.items()))

    def count(self, topic: str) -> int:
        """Number of dropped messages of one topic."""
        return sum(row.count for row in self._counts.values() if row.topic == topic)


@dataclass(frozen=True, slots=True)
class RunProgress:
    """The progress of a run.

    Attributes:
        frames: Frames that have passed the stages.
        written: Frames that are written; offline tracks hold the others back.
        detections: Fused detections in them; tracks come later, drop some and add others.
        drops: Dropped messages so far; reading is ahead of the frames.
        log_time_ns: Log time of the newest frame; before the first one, the start of the recording.
    """

    frames: int
    written: int
    detections: int
    drops: int
    log_time_ns: int


class Tally:
    """Running totals over the frames of a run."""

    def __init__(self, config: Config, rig: Rig) -> None:
        self._class_names = config.object_names
        self._rig, self._places = rig, rig.place_names
        self._detectors = frozenset(detector.topic for detector in rig.detectors)
        self.frames = self.confirmed = self.frames_without_boxes = self.frames_without_boxes3d = 0
        self.compensated = self.odometry = self.odometry_predicted = 0
        # Predicted ones are counted where there are any: without tracks there cannot be.
        self.sources = Counter({source.name.lower(): 0 for source in Source if source != Source.PREDICTED})
        self.objects = Counter[tuple[str, str]]()
        self.points, self.messages, self.copied = Counter[str](), Counter[str](), Counter[str]()
        self.unused_boxes, self.unused_boxes3d = Counter[str](), Counter[str]()
        self.boxes_without_object, self.objects_left_out = Counter[str](), Counter[str]()
        self.road_users = RoadUserTally(config, rig)

    def add_frame(self, frame: FrameResult) -> None:
        """Count one frame."""
        objects = frame.fused.objects
        self.frames += 1
        self.road_users.add_frame(frame)
        self.compensated += bool(frame.combined.compensated)
        self.odometry += frame.odometry is not None
        self.odometry_predicted += frame.odometry is not None and frame.odometry.is_predicted
        self.sources.update(source_names(objects.sources))
        self.confirmed += int((frame.fused.matched > 0).sum())
        self.frames_without_boxes += not frame.detections.cameras
        self.frames_without_boxes3d += bool(self._detectors) and self._detectors.isdisjoint(frame.bundle.messages)
        places = self._rig.place_rows(objects.centers).tolist()
        for class_id, row in zip(objects.class_ids.tolist(), places, strict=True):
            self.objects[self._class_names[class_id], self._places[row]] += 1
        for total, found in (
            (self.points, frame.combined.counts),
            (self.unused_boxes, frame.unused_boxes),
            (self.boxes_without_object, frame.hypotheses.boxes_without_object),
            (self.objects_left_out, frame.fused.left_out),
            (self.unused_boxes3d, frame.unused_boxes3d),
        ):
            total.update(found)
        self.copied.update(message.topic for message in frame.bundle.copied)
        unused = {(drop.topic, drop.stamp_ns) for drop in frame.drops if not drop.parts}
        self.messages.update(topic for topic, m in frame.bundle.messages.items() if (topic, m.stamp_ns) not in unused)

    def frame_summary(self, stats: SyncStats) -> FrameSummary:
        """The counts over the frames so far; `stats` has the spread of their stamps."""
        return FrameSummary(
            count=self.frames,
            objects=dict(sorted(self.objects.items())),
            sources=dict(self.sources),
            confirmed=self.confirmed,
            without_boxes=self.frames_without_boxes,
            without_boxes3d=self.frames_without_boxes3d,
            compensated=self.compensated,
            odometry=self.odometry,
            odometry_predicted=self.odometry_predicted,
            points=dict(self.points),
            skew_mean_ms=stats.skew_mean_ns / 1e6,
            skew_max_ms=stats.skew_max_ns / 1e6,
        )

    def drop_summary(self, messages: tuple[DropCount, ...]) -> DropSummary:
        """The counts so far of data that was not used or not reported, with the dropped messages."""
        return DropSummary(
            messages=messages,
            boxes=dict(sorted(self.unused_boxes.items())),
            boxes3d=dict(sorted(self.unused_boxes3d.items())),
            boxes_without_object=dict(sorted(self.boxes_without_object.items())),
            objects=dict(sorted(self.objects_left_out.items())),
        )
