"""From a recording to bundles, from top to bottom; `lidcam.run.build` turns a bundle into a result."""

import itertools
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lidcam.pipeline.calibration.lidar_poses import NOT_COMPARED, ComparedLidars
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.given import LIDCAMS_OWN, GivenDetectors
from lidcam.pipeline.stages.sync.clocks import Clocks
from lidcam.pipeline.stages.sync.synchronize import MAX_INTERVAL_S, SyncStats, synchronize
from lidcam.readers.recording import Recording
from lidcam.readers.streams.copied import CopiedMessages
from lidcam.readers.streams.motion import MotionBuffer, MotionSource
from lidcam.readers.video.streams import VideoStreams, video_topics
from lidcam.run.box_sources import box_source, detects_in_images
from lidcam.run.choice import AS_GIVEN, UsedSettings
from lidcam.run.missing import MissingSensor, missing_sensors
from lidcam.run.tally import DropTable

SHARE_OF_PERIOD, MAX_SLOW_INTERVAL_S = 0.55, 0.3
"""Largest spread of stamps in a frame by `auto`: share of the period of the slowest required topic, and its limit."""

MAX_MOTION_DELAY_NS = 1_000_000_000
"""Maximum time that a frame waits for odometry that is recorded late, nanoseconds of log time."""

MAX_MOTION_BYTES = 256 << 20
"""Maximum size of the messages of frames that wait for it, but for those of one frame."""

REPEATED = "recorded twice"
"""Reason of drops of messages that equal the one before them, byte by byte."""

SAME_IMAGE = "the same image as the one before, as of a driver that repeats it"
"""Reason of drops of images whose stamps alone are new."""

SAME_CLOUD = "the same cloud as the one before, though the rig has moved"
"""Reason of drops of clouds whose stamps alone are new."""

MIN_MOVED_M = 0.1
"""Minimum way of the rig, as recorded, after which a lidar cannot see the same, metres."""

COMPARED_BYTES = 4096
"""Number of bytes of an image or a cloud, evenly spread, that are compared first."""

HEADER_BYTES = 32
"""Size of the beginning of an image's or a cloud's message that holds its stamp, and its number in ROS 1."""

NOT_EVERY = "of a frame that sync.every leaves out"
"""Reason of drops that the user asked for."""


@dataclass(frozen=True, slots=True)
class TimeWindow:
    """Part of a recording, by log time: `start_ns` included, `stop_ns` not; None is open."""

    start_ns: int | None = None
    stop_ns: int | None = None


def time_window(recording: Recording, start_s: float, duration_s: float | None) -> TimeWindow:
    """The part of a recording to process."""
    start_ns = recording.start_ns + round(start_s * 1e9)
    if start_ns > recording.end_ns:
        seconds = (recording.end_ns - recording.start_ns) / 1e9
        raise ConfigError(f"start at {start_s:g} s: the recording is only {seconds:.3f} s long")
    stop_ns = None if duration_s is None else start_ns + round(duration_s * 1e9)
    return TimeWindow(start_ns if start_s else None, stop_ns)


@dataclass(frozen=True, slots=True)
class RunInput:
    """The source of bundles.

    Attributes:
        recording: The open recording, one topic per sensor.
        rig: Its sensors.
        config: Settings.
        motion: Source of the motion of the site frame; None if it stands still.
        window: Part of the recording.
        settings: The name of the settings and the reason for them.
        copied: Topics whose messages are handed on with the bundles, to be copied to the output.
        drawn: Those of them that are drawn with the results: ground-truth boxes.
        truth_frames: T_site_frame of the fixed frames of the ground truth, beside those of the sensors.
        given: Functions of the caller that find boxes.
        compared: How well the lidars agree.
    """

    recording: Recording
    rig: Rig
    config: Config
    motion: MotionSource | None = None
    window: TimeWindow = TimeWindow()
    settings: UsedSettings = AS_GIVEN
    copied: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()
    truth_frames: tuple[Transform, ...] = ()
    given: GivenDetectors = LIDCAMS_OWN
    compared: ComparedLidars = NOT_COMPARED


def sensor_clocks(rig: Rig, motion: MotionSource | None, drops: DropTable) -> Clocks:
    """The clocks of the rig's sensors and of its odometry; `drops` gets the messages with invalid stamps."""
    sensors: list[tuple[str, LidarSensor | CameraSensor]] = [(lidar.topic, lidar) for lidar in rig.lidars]
    sensors += [(topic, camera) for camera in rig.cameras for topic in (camera.topic, camera.boxes_topic)]
    offsets_ns = {detector.topic: 0 for detector in rig.detectors}
    offsets_ns |= {topic: sensor.time_offset_ns for topic, sensor in sensors}
    offsets_ns |= dict.fromkeys(motion.topics, motion.offset_ns) if motion and motion.is_stamped else {}
    return Clocks(offsets_ns, on_drop=drops.count_defect, on_bad=drops.count_bad, on_start=drops.count_drop)


def bundles(
    source: RunInput, drops: DropTable, stats: SyncStats, clocks: Clocks, last: dict[str, RawMessage] | None = None
) -> Iterator[SensorBundle]:
    """The bundles of a recording, in order, with the motion of the site frame around each and the messages to copy.

    Where time jumps back, synchronisation and motion begin anew: no bundle mixes both sides. `drops` gets every message
    that no bundle uses, `stats` the spread of the stamps in each bundle, and the missing sensors. `last` has the last
    messages read, by topic, and goes on with them: earlier ones, if they come from an earlier part of the recording.
    """
    config, recording, window = source.config, source.recording, source.window
    motion_topics = source.motion.topics if source.motion else ()
    used = frozenset((*synchronized_topics(config, source.rig), *motion_topics))
    messages = recording.messages({*used, *source.copied}, start_ns=window.start_ns, stop_ns=window.stop_ns)
    if not source.copied:
        yield from _bundles(source, drops, stats, clocks, messages, last)
        return
    hooks = {"on_drop": drops.count_drop, "on_bad": drops.count_bad}
    copied = CopiedMessages(source.copied, config.classes, drawn=source.drawn, limits=config.limits, **hooks)
    if window.start_ns is not None:
        copied.read_ahead(recording, window.start_ns)
    found = _bundles(source, drops, stats, clocks, copied.tap(messages, used), last)
    yield from copied.handed_on(found, recording, window.stop_ns)


def _bundles(
    source: RunInput,
    drops: DropTable,
    stats: SyncStats,
    clocks: Clocks,
    messages: Iterable[RawMessage],
    last: dict[str, RawMessage] | None,
) -> Iterator[SensorBundle]:
    config, recording, window = source.config, source.recording, source.window
    motion = MotionBuffer(source.motion, limits=config.limits, on_drop=drops.count_bad)
    topics = synchronized_topics(config, source.rig)
    video = VideoStreams(video_topics(recording, topics), limits=config.limits)
    synchronized = _synchronizer(source, drops, stats)
    if window.start_ns is not None:
        motion.read_ahead(recording, window.start_ns)
        video.look_back(recording, window.start_ns)

    numbers = itertools.count()
    for part in clocks.parts(video.decoded(_once(messages, source, drops, last))):
        part = motion.tap(part)
        part = part if source.motion is None else _without_old_clouds(part, source.rig, motion, drops)
        found = _every(synchronized(part), config.sync.every, numbers, drops)
        found = video.without_blanks(found, on_drop=drops.count_drop, on_bad=drops.count_bad)
        yield from found if source.motion is None else _with_motion(found, motion)
        motion = MotionBuffer(source.motion, limits=config.limits, on_drop=drops.count_bad)


def _synchronizer(
    source: RunInput, drops: DropTable, stats: SyncStats
) -> Callable[[Iterable[RawMessage]], Iterator[SensorBundle]]:
    config, rig = source.config, source.rig
    sync = config.sync
    if sync.max_interval_s == "auto":
        sync = sync.model_copy(update={"max_interval_s": _max_interval_s(source)})
    return partial(
        synchronize,
        topics=synchronized_topics(config, rig),
        config=sync,
        reference=reference_topic(config, rig),
        required=required_topics(config, rig),
        on_drop=drops.count_drop,
        stats=stats,
        max_waiting_bytes=config.limits.max_waiting_bytes,
    )


def _max_interval_s(source: RunInput) -> float:
    """The limit on the spread of stamps in a frame: slow lidars that nothing synchronises are half a period apart."""
    recording, needed = source.recording, required_topics(source.config, source.rig) or ()
    counts = [info.message_count for info in recording.topics if info.topic in needed]
    period_s = (recording.end_ns - recording.start_ns) / 1e9 / max(min(counts, default=0) - 1, 1)
    return min(max(SHARE_OF_PERIOD * period_s, MAX_INTERVAL_S), MAX_SLOW_INTERVAL_S)


def synchronize_stamps(
    source: RunInput, drops: DropTable, stats: SyncStats, clocks: Clocks, messages: Iterable[RawMessage]
) -> None:
    """Synchronise messages as a run does, by their stamps alone: nothing is decoded."""
    topics, synchronized = synchronized_topics(source.config, source.rig), _synchronizer(source, drops, stats)
    used = (message for message in messages if message.topic in topics)
    stamped = (message._replace(data=b"") for message in _once(used, source, drops))
    for part in clocks.parts(stamped):
        deque(synchronized(part), maxlen=0)


def repeats(message: RawMessage, before: RawMessage | None) -> bool:
    """Whether a message has the cloud or the image of the one before it, whatever its stamp."""
    if before is None or len(message.data) <= HEADER_BYTES:
        return False
    one, other = (np.frombuffer(each.data, np.uint8)[HEADER_BYTES:] for each in (message, before))
    step = len(one) // COMPARED_BYTES + 1  # some bytes tell most that differ, in a twentieth of the time
    return np.array_equal(one[::step], other[::step]) and np.array_equal(one, other)


def _once(
    messages: Iterable[RawMessage], source: RunInput, drops: DropTable, last: dict[str, RawMessage] | None = None
) -> Iterator[RawMessage]:
    """Messages without those that equal the one before them, as of two recorders, or of two publishers.

    A stamp of 0 says nothing: messages without boxes are alike. Images that go to a detector are left out as well if
    their stamp alone is new: the noise of a sensor makes every image another one. `last` is that of `bundles`.
    """
    last = {} if last is None else last
    topics = synchronized_topics(source.config, source.rig)
    images = decoded_topics(source.config, source.rig) & {camera.topic for camera in source.rig.cameras}
    images -= {*video_topics(source.recording, topics)}  # a still scene may be coded as the same again and again
    for message in messages:
        topic, before, reason = message.topic, last.get(message.topic), ""
        if before and before.order != message.order:
            if before.stamp_ns == message.stamp_ns:
                reason = REPEATED if message.stamp_ns and before.data == message.data else ""
            elif topic in images and repeats(message, before):
                reason = SAME_IMAGE
        if topic in topics:
            last[topic] = message
        if reason:
            drops.count_drop(Drop(topic, message.stamp_ns, reason))
        else:
            yield message


def _without_old_clouds(
    messages: Iterable[RawMessage], rig: Rig, motion: MotionBuffer, drops: DropTable
) -> Iterator[RawMessage]:
    """Messages without clouds that a driver repeats; a rig that stands in a simulated world may see the same again."""
    lidars = {lidar.topic for lidar in rig.lidars}
    last: dict[str, tuple[RawMessage, F64]] = {}
    for message in messages:
        if message.topic in lidars:
            poses = motion.window(message.stamp_ns)
            place = poses.at(message.stamp_ns)[0, :3, 3] if len(poses) > 1 else np.full(3, np.nan)
            before, there = last.get(message.topic, (message, place))
            if np.linalg.norm(place - there) > MIN_MOVED_M and repeats(message, before):
                drops.count_drop(Drop(message.topic, message.stamp_ns, SAME_CLOUD))
                continue
            last[message.topic] = message, place
        yield message


def missing_from_frames(source: RunInput, stats: SyncStats) -> list[MissingSensor]:
    """Sensors that are missing from frames."""
    absences = stats.attendance.absences(synchronized_topics(source.config, source.rig))
    of_frames, start_ns = -(-stats.sets // source.config.sync.every), source.recording.start_ns
    return missing_sensors(absences, source.rig, stats.attendance.groups, of_frames=of_frames, start_ns=start_ns)


def _every(
    found: Iterable[SensorBundle], every: int, numbers: Iterator[int], drops: DropTable
) -> Iterator[SensorBundle]:
    """Every Nth bundle, with the drops since the last one; `numbers` counts over all parts of a recording."""
    dropped = Counter[tuple[str, str]]()
    for bundle in found:
        number = next(numbers)
        dropped.update(bundle.dropped_before)
        if number % every == 0:
            yield replace(bundle, index=number // every, dropped_before=dict(dropped))
            dropped.clear()
        else:
            for message in bundle.messages.values():
                drops.count_drop(Drop(message.topic, message.stamp_ns, NOT_EVERY))


def synchronized_topics(config: Config, rig: Rig) -> tuple[str, ...]:
    """The topics of a bundle: lidars, 3D boxes, images where they are used or copied, 2D boxes."""
    topics = [lidar.topic for lidar in rig.lidars] + [detector.topic for detector in rig.detectors]
    if config.output.images or detects_in_images(config, rig):
        topics += [camera.topic for camera in rig.cameras if camera.topic]
    if box_source(config, rig) == "recorded":
        topics += [camera.boxes_topic for camera in rig.cameras if camera.boxes_topic]
    return tuple(topics)


def decoded_topics(config: Config, rig: Rig) -> frozenset[str]:
    """The topics of a bundle whose messages are decoded; images may only be copied."""
    copied = set() if detects_in_images(config, rig) else {camera.topic for camera in rig.cameras}
    return frozenset(synchronized_topics(config, rig)) - copied


def expected_frames(source: RunInput) -> int:
    """Approximate number of bundles: that of the messages of the reference topic in the window."""
    recording, window = source.recording, source.window
    topic = reference_topic(source.config, source.rig)
    count = sum(info.message_count for info in recording.topics if info.topic == topic)
    start_ns = recording.start_ns if window.start_ns is None else window.start_ns
    stop_ns = recording.end_ns if window.stop_ns is None else min(window.stop_ns, recording.end_ns)
    share = (stop_ns - start_ns) / max(recording.end_ns - recording.start_ns, 1)
    return math.ceil(count * min(share, 1.0) / source.config.sync.every)


def required_topics(config: Config, rig: Rig) -> tuple[str, ...] | None:
    """Topics that a bundle needs while their sensors are alive, in the order of `synchronized_topics`; None: all.

    Raises:
        ConfigError: a configured one is not among the synchronised topics.
    """
    required = config.sync.required
    if required == "all":
        return None
    sensors = {sensor.topic for sensor in rig.lidars or rig.detectors}
    wanted = sensors if required == "lidars" else {*required}
    topics = synchronized_topics(config, rig)
    if unknown := sorted(wanted - {*topics}):
        raise ConfigError(f"sync.required: {', '.join(unknown)} is not among the topics in use: {', '.join(topics)}")
    wanted |= {config.sync.reference}
    return tuple(topic for topic in topics if topic in wanted)


def reference_topic(config: Config, rig: Rig) -> str:
    """The topic whose messages give frames their stamps, while it is alive.

    Raises:
        ConfigError: the configured one, or a required one, is not among the synchronised topics.
    """
    topics, required = synchronized_topics(config, rig), required_topics(config, rig)
    reference = config.sync.reference or (required or topics)[0]
    if reference not in topics:
        raise ConfigError(f"sync.reference: {reference!r} is not among the topics in use: {', '.join(topics)}")
    return reference


def no_frames(source: RunInput, drops: DropTable) -> str:
    """The error of a run without frames."""
    config, rig = source.config, source.rig
    topics, required = synchronized_topics(config, rig), required_topics(config, rig)
    needed = topics if required is None else required or topics[:1]
    paths = ", ".join(str(path) for path in source.recording.paths)
    if source.window != TimeWindow() and not any(drops.count(topic) for topic in topics):
        return (
            f"{paths}: expected messages of {', '.join(needed)} in the part given by start and duration, found none in "
            "it; take a longer part"
        )
    found = ", ".join(f"{topic} {drops.count(topic)}" for topic in topics)
    every = "topic" if required is None else f"required topic ({', '.join(needed)})"
    return (
        f"{paths}: no moment has a message of every {every}; "
        f"messages by topic: {found}; require fewer with --set sync.required=[{needed[0]}], or widen "
        "sync.max_interval_s"
    )


def _with_motion(found: Iterator[SensorBundle], motion: MotionBuffer) -> Iterator[SensorBundle]:
    """Bundles with the poses around their stamps.

    A bundle may be complete before the poses of its sweep are read: it waits for the next one, and longer where
    odometry is recorded late.
    """
    waiting = deque[SensorBundle]()
    for bundle in found:
        while waiting and (
            (motion.newest_ns or 0) > waiting[0].stamp_ns
            or bundle.log_time_ns - waiting[0].log_time_ns >= MAX_MOTION_DELAY_NS
            or sum(len(message.data) for one in waiting for message in one.messages.values()) > MAX_MOTION_BYTES
        ):
            yield _with_later_poses(waiting.popleft(), motion)
        waiting.append(replace(bundle, motion=motion.window(bundle.stamp_ns)))
    for bundle in waiting:
        yield _with_later_poses(bundle, motion)


def _with_later_poses(bundle: SensorBundle, motion: MotionBuffer) -> SensorBundle:
    later = motion.window(bundle.stamp_ns)
    known = bundle.motion
    if not len(later) or (known and later.stamps_ns[0] > known.stamps_ns[0]):
        return bundle  # after a pause the buffer no longer covers this bundle
    return replace(bundle, motion=later)
