"""One run over a recording: read, synchronise, push through the stages, write, count."""

import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

from lidcam.build import BoxSource, box_source, build_graph, wanted_boxes
from pipeline.core.errors import ConfigError, MessageError, RecordingError
from pipeline.core.frame import FrameResult, SensorBundle
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.messages import Drop
from pipeline.core.rig import Rig
from pipeline.core.settings.config import Config
from pipeline.graph import Graph, Node
from pipeline.stages.sync.synchronize import SyncStats, synchronize
from readers.recording import Loss, Recording
from readers.rig.sensor_topics import BOXES, IMAGE
from readers.streams.decoders import OnBadMessage
from readers.streams.motion import MotionBuffer, MotionSource
from readers.video.streams import VideoStreams, video_topics
from writers.base import ResultWriter

__all__ = ["OUTSIDE_ZONES", "DropTable", "RunSummary", "TimeWindow", "process", "synchronized_topics"]

READ_AHEAD_NS = 2_000_000_000
"""Poses recorded this long before a window are read, too."""

OUTSIDE_ZONES = "outside"
"""Column of objects that no zone holds."""


class DropTable:
    """Messages, and parts of them, that took no part, by topic and reason; memory does not grow with their number."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, str]] = Counter()
        self.examples: dict[tuple[str, str], str] = {}

    def add(self, drop: Drop) -> None:
        """Count one, or its parts; the first detail of its kind is kept as the example."""
        key = (drop.topic, drop.reason)
        self.counts[key] += drop.parts or 1
        if drop.detail:
            self.examples.setdefault(key, drop.detail)


@dataclass(frozen=True, slots=True)
class TimeWindow:
    """Part of a recording, by log time: `start_ns` included, `stop_ns` not; None is open."""

    start_ns: int | None = None
    stop_ns: int | None = None


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run did.

    Attributes:
        frames: Frames written.
        box_source: Where 2D boxes came from.
        motion_topics: Where the motion of the site frame came from; empty where it stands still.
        compensated: Frames with a cloud that was moved to the frame's time.
        objects: Fused objects by (class name, zone name).
        confirmed: Fused objects that at least one camera confirms.
        points: Lidar points by step of the combination, summed over the frames.
        messages_used: Messages that took part, by topic.
        drops: Messages that did not.
        losses: What is damaged in the files that were read.
        unused_boxes: Recorded 2D boxes that could not be used, by reason.
        skew_mean_ms: Mean spread of the stamps in a set.
        skew_max_ms: Largest.
        stage_seconds: Time spent per stage, summed over the frames; stages overlap when the run is pipelined.
        wall_seconds: From the first message to the last result.
    """

    frames: int
    box_source: BoxSource
    motion_topics: tuple[str, ...]
    compensated: int
    objects: Mapping[tuple[str, str], int]
    confirmed: int
    points: Mapping[str, int]
    messages_used: Mapping[str, int]
    drops: DropTable
    losses: tuple[Loss, ...]
    unused_boxes: Mapping[str, int]
    skew_mean_ms: float
    skew_max_ms: float
    stage_seconds: Mapping[str, float]
    wall_seconds: float

    @property
    def frames_per_second(self) -> float:
        """Frames by wall time."""
        return self.frames / self.wall_seconds if self.wall_seconds else 0.0


def process(
    recording: Recording,
    rig: Rig,
    config: Config,
    writers: Sequence[ResultWriter],
    *,
    motion_source: MotionSource | None = None,
    window: TimeWindow = TimeWindow(),
    on_bad: OnBadMessage = "skip",
    on_result: Callable[[FrameResult], None] = lambda _: None,
    early_drops: Sequence[Drop] = (),
) -> RunSummary:
    """Process a recording to its end.

    Args:
        recording: Open recording.
        rig: Its sensors.
        config: Settings.
        writers: Each gets every frame, in order, on a thread of its own.
        motion_source: Odometry of the site frame, if there is any.
        window: Part of the recording.
        on_bad: What to do about messages that cannot be decoded.
        on_result: Called with every frame, in order.
        early_drops: Messages that were found bad while the rig was being found.

    Raises:
        RecordingError: reading fails, not one set of messages belongs together, or 2D boxes are wanted of a recording
            without any camera.
        MessageError: a message cannot be decoded and `on_bad` is `fail`.
    """
    topics = synchronized_topics(config, rig)
    reference = config.sync.reference or rig.lidars[0].topic
    if reference not in topics:
        raise ConfigError(f"sync.reference: {reference!r} is not among the topics in use: {', '.join(topics)}")
    drops, tally, stats, started = DropTable(), _Tally(config, rig), SyncStats(), time.perf_counter()

    def bad(drop: Drop) -> None:
        if on_bad == "fail":
            raise MessageError(drop.detail or f"{drop.topic}: {drop.reason}")
        drops.add(drop)

    graph, result = build_graph(config, rig, on_bad=on_bad)
    _check_box_source(recording, config, rig)
    for writer in writers:
        result = graph.add(f"write {writer.name}", partial(_write, writer), result)
    motion = MotionBuffer(motion_source, on_drop=bad) if motion_source else None
    for drop in early_drops:
        if motion is None or drop.topic not in motion.topics:  # those will be met again
            bad(drop)
    wanted = {*topics, *(motion.topics if motion else ())}
    messages = recording.messages(wanted, start_ns=window.start_ns, stop_ns=window.stop_ns)
    if motion and window.start_ns is not None:
        _read_ahead(motion, recording, window.start_ns)
    video = VideoStreams(video_topics(recording, topics), limits=config.limits)
    if window.start_ns is not None:
        video.look_back(recording, window.start_ns)
    messages = video.decoded(messages)
    bundles = synchronize(
        motion.tap(messages) if motion else messages,
        topics,
        config.sync,
        reference=reference,
        on_drop=drops.add,
        stats=stats,
    )
    bundles = video.without_blanks(bundles, on_drop=drops.add, on_bad=bad)
    frames = _with_motion(bundles, motion) if motion else bundles
    with closing(_run(graph, result, frames, config)) as results:
        for frame in results:
            tally.add(frame)
            for drop in frame.drops:
                bad(drop)
            on_result(frame)
    if tally.frames == 0:
        raise RecordingError(_no_frames(recording, topics, drops))
    return RunSummary(
        frames=tally.frames,
        box_source=box_source(config, rig),
        motion_topics=motion.topics if motion else (),
        compensated=tally.compensated,
        objects=dict(sorted(tally.objects.items())),
        confirmed=tally.confirmed,
        points=dict(tally.points),
        messages_used=dict(sorted(tally.messages.items())),
        drops=drops,
        losses=recording.losses,
        unused_boxes=dict(sorted(tally.unused_boxes.items())),
        skew_mean_ms=stats.skew_mean_ns / 1e6,
        skew_max_ms=stats.skew_max_ns / 1e6,
        stage_seconds=dict(graph.seconds),
        wall_seconds=time.perf_counter() - started,
    )


def synchronized_topics(config: Config, rig: Rig) -> tuple[str, ...]:
    """Topics that make up a set: lidars, then images where they are looked at or copied, then recorded boxes."""
    source = box_source(config, rig)
    topics = [lidar.topic for lidar in rig.lidars]
    if config.output.images or source == "onnx":
        topics += [camera.topic for camera in rig.cameras if camera.topic]
    if source == "recorded":
        topics += [camera.boxes_topic for camera in rig.cameras if camera.boxes_topic]
    return tuple(topics)


def _check_box_source(recording: Recording, config: Config, rig: Rig) -> None:
    """Cameras that were recorded and cannot be used are faults of the rig, and the run goes on without them."""
    wanted = wanted_boxes(config, rig)
    if wanted == "none":
        return
    expected, needed, remedy = {
        "onnx": ("images for the 2D network", IMAGE, "leave out --model-2d"),
        "recorded": ("recorded 2D boxes", BOXES, "set detect2d.method to auto"),
    }[wanted]
    if not any(info.msgtype in needed and info.message_count for info in recording.topics):
        raise RecordingError(
            f"{', '.join(map(str, recording.paths))}: expected {expected} ({' or '.join(sorted(needed))}), found no "
            f"such topic with messages; {remedy} to go by the lidars alone"
        )


def _run(
    graph: Graph[SensorBundle], result: Node[FrameResult], frames: Iterator[SensorBundle], config: Config
) -> Generator[FrameResult, None, None]:
    if config.run.workers == 1:
        return graph.run(result, frames)
    return graph.run_pipelined(result, frames, window=config.run.window or config.run.workers + 2)


def _with_motion(bundles: Iterator[SensorBundle], motion: MotionBuffer) -> Iterator[SensorBundle]:
    """Bundles with the poses around their stamps.

    A bundle is complete when its last message was read, which may be before the poses of its sweep were: so it waits
    for the next one, and is given what is known by then.
    """
    waiting: SensorBundle | None = None
    for bundle in bundles:
        if waiting is not None:
            yield _with_later_poses(waiting, motion)
        waiting = replace(bundle, motion=motion.window(bundle.stamp_ns))
    if waiting is not None:
        yield _with_later_poses(waiting, motion)


def _with_later_poses(bundle: SensorBundle, motion: MotionBuffer) -> SensorBundle:
    later = motion.window(bundle.stamp_ns)
    if later is None or (bundle.motion is not None and later.stamps_ns[0] > bundle.motion.stamps_ns[0]):
        return bundle  # a pause so long that the buffer has let go of this bundle's time
    return replace(bundle, motion=later)


def _read_ahead(motion: MotionBuffer, recording: Recording, start_ns: int) -> None:
    """Take in the poses that were recorded just before a window: its first sweeps began there."""
    before = recording.messages(motion.topics, start_ns=start_ns - READ_AHEAD_NS, stop_ns=start_ns)
    deque(motion.tap(before), maxlen=0)


def _write(writer: ResultWriter, result: FrameResult) -> FrameResult:
    not_copied = writer.write(result)
    return replace(result, drops=result.drops + not_copied) if not_copied else result


def _no_frames(recording: Recording, topics: Sequence[str], drops: DropTable) -> str:
    dropped = Counter[str]()
    for (topic, _), count in drops.counts.items():
        dropped[topic] += count
    found = ", ".join(f"{topic} {dropped[topic]}" for topic in topics)
    return (
        f"{', '.join(str(path) for path in recording.paths)}: no moment has a message of every topic; "
        f"messages by topic: {found}; leave out a topic with --set topics.exclude=[TOPIC] or widen sync.max_interval_s"
    )


class _Tally:
    """Running totals over the frames."""

    def __init__(self, config: Config, rig: Rig) -> None:
        self._class_names = config.class_names
        self._zones = rig.zones
        self.frames = 0
        self.confirmed = 0
        self.compensated = 0
        self.objects: Counter[tuple[str, str]] = Counter()
        self.points: Counter[str] = Counter()
        self.messages: Counter[str] = Counter()
        self.unused_boxes: Counter[str] = Counter()

    def add(self, frame: FrameResult) -> None:
        self.frames += 1
        self.compensated += bool(frame.combined.compensated)
        self.confirmed += int((frame.fused.matched > 0).sum())
        rows = first_polygon_with([zone.polygon_site for zone in self._zones], frame.fused.objects.centers[:, :2])
        for class_id, row in zip(frame.fused.objects.class_ids.tolist(), rows.tolist(), strict=True):
            zone = self._zones[row].name if row >= 0 else OUTSIDE_ZONES
            self.objects[self._class_names[class_id], zone] += 1
        self.points.update(dict(frame.combined.counts))
        self.unused_boxes.update(dict(frame.unused_boxes))
        unused = {(drop.topic, drop.stamp_ns) for drop in frame.drops if not drop.parts}
        self.messages.update(topic for topic, m in frame.bundle.messages.items() if (topic, m.stamp_ns) not in unused)
