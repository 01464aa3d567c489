"""The motion of the site frame, which clouds are compensated for: from odometry, or from tf.

A recording may have odometry of other objects (the ground truth of a car that drives through the scene): a source is
used only if its child frame is the site frame or fixed to it.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.errors import ConfigError, FrameError, MessageError
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples, interpolate_poses
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Drop, RawMessage, time_fault
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.tf import (
    ODOMETRY,
    TF_TYPES,
    RecordedTransforms,
    clean_frame,
    decode_odometry,
    decode_transforms,
    tf_topics,
)
from lidcam.readers.recording import Recording
from lidcam.readers.rig.clocks import clock_offsets
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import is_excluded

KEPT_NS = 5_000_000_000
"""Time for which poses are kept: messages leave the synchroniser a few periods after they were recorded."""

READ_AHEAD_NS = 2_000_000_000
"""Poses recorded this long before a window are read, too."""

WINDOW_NS = 500_000_000
"""Half of a frame's window: a sweep takes 0.1 s, and the sensors of one frame are less than that apart."""

_FAR_OFF = "the stamp before this one was far from all others"

FIXED_FRAMES = ("odom", "map", "world", "earth")
"""REP 105; `odom` first, since it moves without jumps."""


class MotionSource(NamedTuple):
    """The source of the site frame's poses."""

    topics: tuple[str, ...]  # Topics of odometry or of transforms
    frame_id: str  # The site frame
    fixed_frame_id: str  # The frame that it moves in
    # The chain from the site frame to the fixed frame, the site frame's own link first: a transform where it is static,
    # else the name of the frame that moves in its parent
    links: tuple[Transform | str, ...]
    offset_ns: int = 0  # Offset of the stamps of odometry whose clock was not set
    # Whether its messages have stamps, as those of odometry; those of tf have one per transform
    is_stamped: bool = True


def find_motion_source(
    recording: Recording,
    rig: Rig,
    transforms: RecordedTransforms,
    config: Config,
    *,
    usual_delay_ns: int | None = None,
    on_unused: Callable[[str], None] = lambda _: None,
) -> MotionSource | None:
    """The configured odometry, else odometry of the site frame, else its tf; None if the site does not move.

    Of several odometry topics the one with the most messages is used, then the first by name. `usual_delay_ns` is that
    of the sensors, log time minus stamp; None: the clock of the odometry is believed. `on_unused` gets the reason for
    each odometry or tf that is not used, but for those of objects in the scene. Raises ConfigError if the configured
    topic has no odometry, or odometry of a frame that is not fixed to the site frame.
    """
    if not config.combine.motion.enabled:
        return None
    first = FirstMessages(recording, limits=config.limits)
    infos = [
        info
        for info in recording.topics
        if info.msgtype == ODOMETRY
        and info.message_count
        and not info.unreadable
        and not is_excluded(info.topic, config.topics)
    ]
    wanted = config.combine.motion.topic
    if wanted:
        if wanted not in {info.topic for info in infos}:
            names = ", ".join(info.topic for info in infos) or "none"
            raise ConfigError(f"combine.motion.topic: expected a recorded {ODOMETRY} topic ({names}), found {wanted!r}")
        source = _of_odometry(wanted, first, rig, transforms, is_wanted=True)
        return _with_clock_set(source, recording, first, usual_delay_ns)
    for info in sorted(infos, key=lambda info: (-info.message_count, info.topic)):
        try:
            source = _of_odometry(info.topic, first, rig, transforms, is_wanted=False)
        except _OfObject:
            continue
        except (ConfigError, MessageError) as err:
            on_unused(str(err))
            continue
        return _with_clock_set(source, recording, first, usual_delay_ns)
    found, site = _of_tf(recording, rig, transforms), rig.site_frame
    for child, parent in transforms.moving.items() if found is None else ():
        if parent in FIXED_FRAMES and not transforms.are_joined(site, parent):
            on_unused(f"tf: {child!r} moves in {parent!r}, not joined with the site frame {site!r}; {_join(child)}")
    return found


def _join(child: str) -> str:
    """Remedy for motion of a frame that may be the rig's."""
    return f"if it is of the rig, give the pose of {child!r} in a rig file (transforms)"


class _OfObject(ConfigError):
    """Odometry of an object in the scene."""


def _of_odometry(
    topic: str, first: FirstMessages, rig: Rig, transforms: RecordedTransforms, *, is_wanted: bool
) -> MotionSource:
    message = first.decoded(topic, {ODOMETRY})
    child, fixed = clean_frame(message.child_frame_id), clean_frame(message.header.frame_id)
    if not child and is_wanted:  # many drivers leave it empty
        child = rig.site_frame
    what = f"{topic}: pose of {child!r} in {fixed!r} is not the motion of the site frame {rig.site_frame!r}"
    if child and transforms.are_joined(rig.site_frame, fixed):
        raise _OfObject(what)
    if not child or not fixed:
        raise ConfigError(f"{what}; if it is, --set combine.motion.topic={topic}" if fixed else what)
    if child == rig.site_frame:
        return MotionSource((topic,), rig.site_frame, fixed, (child,))
    try:
        return MotionSource((topic,), rig.site_frame, fixed, (transforms.lookup(child, rig.site_frame), child))
    except FrameError as err:
        raise ConfigError(f"{topic}: odometry of {child!r}, not of the site frame: {err}; {_join(child)}") from err


def _with_clock_set(
    source: MotionSource, recording: Recording, first: FirstMessages, usual_delay_ns: int | None
) -> MotionSource:
    (topic,) = source.topics
    delay_ns = first.delay_ns(topic, {ODOMETRY})
    if delay_ns is None or usual_delay_ns is None:
        return source
    return source._replace(offset_ns=clock_offsets(recording, {topic: delay_ns}, usual_delay_ns).get(topic, 0))


def links_up(
    frame_id: str, transforms: RecordedTransforms, *, is_end: Callable[[str], bool]
) -> tuple[list[Transform | str], list[str]] | None:
    """The way from a frame to its parents, to the first one that is an end, or to a root.

    Returns:
        The links (a transform, or the name of the child where it moves), and the frames that they join, one more; None
        if the parents go round in a circle.
    """
    links: list[Transform | str] = []
    frames = [frame_id]
    while not is_end(frame := frames[-1]):
        if frame in transforms.moving:
            links.append(frame)
            parent = transforms.moving[frame]
        elif (edge := transforms.fixed.edge(frame)) is not None:
            links.append(edge)
            parent = edge.dst
        else:
            break
        if parent in frames:
            return None
        frames.append(parent)
    return links, frames


def _of_tf(recording: Recording, rig: Rig, transforms: RecordedTransforms) -> MotionSource | None:
    way = links_up(rig.site_frame, transforms, is_end=lambda _: False)
    if way is None:
        return None
    links, frames = way
    moves = [i for i, link in enumerate(links) if isinstance(link, str)]
    if not moves:
        return None
    above = frames[moves[0] + 1 :]
    fixed = next((frame for frame in FIXED_FRAMES if frame in above), above[-1])
    links, topics = links[: frames.index(fixed)], tuple(tf_topics(recording)[1])
    return MotionSource(topics, rig.site_frame, fixed, tuple(links), is_stamped=False)


class _Track:
    """Poses of one frame in its parent, ordered by time."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self.poses: list[F64] = []
        self._held: tuple[int, F64] | None = None

    def add_pose(self, stamp_ns: int, pose: F64) -> bool:
        """Insert a pose, or replace that of the same stamp; forget those older than `KEPT_NS`.

        One that is more than `KEPT_NS` ahead or behind is held until the next one agrees with it: then the clock was
        set, or those before were wrong.

        Returns:
            Whether the poses before it, the one that was held among them, are sound.
        """
        held, self._held = self._held, None
        if not self.stamps_ns or abs(stamp_ns - self.stamps_ns[-1]) <= KEPT_NS:
            self._insert(stamp_ns, pose)
            return held is None
        if held is None or abs(stamp_ns - held[0]) > KEPT_NS:
            self._held = stamp_ns, pose
            return held is None
        is_back = stamp_ns < self.stamps_ns[-1]
        if is_back:
            self.stamps_ns.clear()
            self.poses.clear()
        self._insert(*held)
        self._insert(stamp_ns, pose)
        return not is_back

    def _insert(self, stamp_ns: int, pose: F64) -> None:
        at = bisect_left(self.stamps_ns, stamp_ns)
        if at < len(self.stamps_ns) and self.stamps_ns[at] == stamp_ns:
            self.poses[at] = pose
            return
        self.stamps_ns.insert(at, stamp_ns)
        self.poses.insert(at, pose)
        old = bisect_left(self.stamps_ns, self.stamps_ns[-1] - KEPT_NS)
        del self.stamps_ns[:old], self.poses[:old]

    def around(self, stamp_ns: int) -> tuple[I64, F64]:
        """Stamps (S,) and poses (S, 4, 4) within the window, and the next one on either side."""
        low = max(bisect_left(self.stamps_ns, stamp_ns - WINDOW_NS) - 1, 0)
        high = bisect_left(self.stamps_ns, stamp_ns + WINDOW_NS + 1) + 1
        poses = self.poses[low:high]
        return np.array(self.stamps_ns[low:high], np.int64), np.array(poses, np.float64).reshape(-1, 4, 4)


class MotionBuffer:
    """The last few seconds of the site frame's motion, filled from the stream of messages.

    Poses recorded after the stream's current message are not known yet: for the newest frame the motion has to be
    extrapolated.
    """

    def __init__(
        self,
        source: MotionSource | None,
        *,
        limits: RecordingLimits = DEFAULT_LIMITS,
        on_drop: Callable[[Drop], None] = lambda _: None,
    ) -> None:
        """Without a source the site stands still: no topics, no poses."""
        self._source = source or MotionSource((), "", "", ())
        self._limits = limits
        self._on_drop = on_drop
        self._tracks = {link: _Track() for link in self._source.links if isinstance(link, str)}
        links = self._source.links
        ends = [link.src if isinstance(link, Transform) else link for link in links[1:]]
        parents = zip(links, [*ends, self._source.fixed_frame_id][: len(links)], strict=True)
        self._parents = {link: parent for link, parent in parents if isinstance(link, str)}

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that the stream must contain."""
        return self._source.topics

    @property
    def newest_ns(self) -> int | None:
        """Stamp up to which the motion of all frames of the chain is known; None if that of one is not known at all."""
        tracks = self._tracks.values()
        return (
            min((track.stamps_ns[-1] for track in tracks), default=None) if all(t.stamps_ns for t in tracks) else None
        )

    def read_ahead(self, recording: Recording, start_ns: int) -> None:
        """Take in the poses that were recorded just before a window: its first sweeps began there."""
        if self.topics:
            before = recording.messages(self.topics, start_ns=start_ns - READ_AHEAD_NS, stop_ns=start_ns)
            deque(self.tap(before), maxlen=0)

    def tap(self, messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
        """Take the source's messages out of the stream; those that cannot be used are dropped."""
        for message in messages:
            if message.topic not in self._source.topics:
                yield message
                continue
            try:
                self._take(message)
            except MessageError as err:
                self._on_drop(Drop(message.topic, message.stamp_ns, "cannot be decoded", str(err)))
            except FrameError as err:
                self._on_drop(Drop(message.topic, message.stamp_ns, "its pose is unusable", str(err)))

    def window(self, stamp_ns: int) -> PoseSamples:
        """Poses of the site frame around a time; none where fewer than two are known."""
        tracks = {name: track.around(stamp_ns) for name, track in self._tracks.items()}
        stamps_ns = np.zeros(0, np.int64)
        if all(len(stamps) > 1 for stamps, _ in tracks.values()):
            begin = max(stamps[0] for stamps, _ in tracks.values())
            end = min(stamps[-1] for stamps, _ in tracks.values())
            densest = max((stamps for stamps, _ in tracks.values()), key=len)
            stamps_ns = densest[(densest >= begin) & (densest <= end)]
        if len(stamps_ns) < 2:
            none = np.zeros((0, 4, 4))
            return PoseSamples(self._source.frame_id, self._source.fixed_frame_id, stamps_ns[:0], none)
        poses = np.broadcast_to(np.eye(4), (len(stamps_ns), 4, 4))
        for link in self._source.links:
            if isinstance(link, Transform):
                poses = link.matrix @ poses
                continue
            known_ns, known = tracks[link]
            same = np.array_equal(known_ns, stamps_ns)
            poses = (known if same else interpolate_poses(known_ns, known, stamps_ns)) @ poses
        return PoseSamples(self._source.frame_id, self._source.fixed_frame_id, stamps_ns, np.ascontiguousarray(poses))

    def _take(self, message: RawMessage) -> None:
        if message.channel.msgtype in TF_TYPES:
            fault: FrameError | None = None
            found = decode_transforms(message, limits=self._limits, is_wanted=lambda _, child: child in self._tracks)
            for stamp_ns, transform, child in found:
                if child not in self._tracks:
                    continue
                if not_a_time := time_fault(stamp_ns):
                    fault = fault or FrameError(f"{child}: its stamp cannot be a time: {not_a_time}")
                elif not isinstance(transform, Transform):
                    fault = fault or FrameError(f"{child}: {transform}")
                elif transform.dst != self._parents[child]:
                    fault = fault or FrameError(f"{child} in {transform.dst!r}, expected {self._parents[child]!r}")
                elif not self._tracks[child].add_pose(stamp_ns, transform.matrix):
                    fault = fault or FrameError(f"{child}: {_FAR_OFF}")
            if fault:
                raise fault
            return
        pose = decode_odometry(message, limits=self._limits)
        if pose.dst != self._source.fixed_frame_id:
            raise FrameError(f"pose in {pose.dst!r}, expected {self._source.fixed_frame_id!r} as in the first message")
        child = next(iter(self._tracks))
        if pose.src not in {"", child}:
            raise FrameError(f"pose of {pose.src!r}, expected {child!r} as in the first message")
        if not self._tracks[child].add_pose(message.stamp_ns, pose.matrix):
            raise FrameError(_FAR_OFF)
