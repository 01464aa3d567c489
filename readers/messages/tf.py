"""Reads transforms from /tf and /tf_static.

tf/tfMessage (ROS 1) and tf2_msgs/TFMessage have the same content; leading slashes of frame names, written by old ROS 1
drivers, are removed. Old ROS 1 systems publish fixed mountings repeatedly on /tf (tf's static_transform_publisher), so
a frame whose transform never changes counts as fixed, unless its parent is a frame that vehicles move in (`odom`,
`map`, `earth`; REP 105): a parked vehicle may drive off later.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice
from math import isfinite
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import CalibrationError, FrameError, MessageError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import Drop, RawMessage
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits
from lidcam.readers.messages.decoding import decoder
from lidcam.readers.messages.deserialize import deserialize_as, pose_numbers
from lidcam.readers.messages.registry import types_of
from lidcam.readers.recording import Recording

ODOMETRY = "nav_msgs/msg/Odometry"


@decoder
def decode_odometry(message: RawMessage, *, limits: RecordingLimits = DEFAULT_LIMITS) -> Transform:
    """The pose of the child frame, which is empty if the publisher does not name it, in the frame that it moves in."""
    odometry = deserialize_as(message, ODOMETRY, limits=limits)
    parent, child = clean_frame(odometry.header.frame_id), clean_frame(odometry.child_frame_id)
    if not parent or parent == child:
        raise MessageError(f"{message.topic}: expected two frame names, found frame_id {parent!r}, child {child!r}")
    try:
        return Transform.from_quaternion(parent, child, *pose_numbers(odometry.pose.pose))
    except FrameError as err:
        raise MessageError(f"{message.topic}: {err}") from err


TF_TYPES = types_of("transforms")

ODOMETRY_FRAMES = frozenset({"odom", "map", "earth"})
PROBE_NS = 60_000_000_000
"""Length of /tf that is read before the run: enough to see every frame without reading a long recording twice."""

BEGINNING_NS = 2_000_000_000
"""Length of /tf that is read from the start, for any time window, and at its end: fixed frames are sent more often."""

MAX_STILL_CHANGE = 1e-6
"""Largest change of a matrix entry (metres, or roughly radians) of a fixed frame."""

MAX_ROUNDED = 1e-3
"""Largest change of a matrix entry between two transforms of tf_static that are meant to be the same."""

MAX_SWAY = 0.15
"""Largest change of a matrix entry (metres, or roughly radians) of a frame on springs or on a mast."""

GROUND_WORDS = frozenset({*ODOMETRY_FRAMES, "world"})
"""Words in the names of frames that vehicles move in: what moves a little there may drive off."""

MAX_TF_BYTES = 64 << 20
"""Size of /tf_static, and of the part of /tf, that are read: hours of a vehicle's fixed frames at ten hertz."""

MAX_MOVING_NAMED = 3
"""Largest number of moving frames that an error names, if none of them is what is looked up."""

NUMBERS = Struct("<7d")
"""Translation, and rotation x, y, z, w."""

QUATERNION_TOLERANCE = 0.01
"""Largest deviation of a quaternion's squared length from 1 that tf2 accepts (tf2::BufferCore::setTransform)."""


class Sway(NamedTuple):
    """The movement of a frame that stays near its mean pose."""

    mean: Transform  # T_parent_child
    turn_deg: float  # Largest distance from it, of angles
    shift_m: float  # And of places


@dataclass(frozen=True, slots=True)
class RecordedTransforms:
    """The recorded transforms between frames."""

    fixed: TransformTree  # Transforms that do not change
    moving: Mapping[str, str] = field(default_factory=dict)  # Parent by child, for frames that move
    # Fault of a frame's recorded transform, by child; such transforms are not used
    faults: Mapping[str, str] = field(default_factory=dict)
    # Frames of tf_static that it, or tf, has in several places, or with several parents
    changed: frozenset[str] = frozenset()
    swaying: Mapping[str, Sway] = field(default_factory=dict)  # By child, the moving frames that stay near one pose
    # The first message of each topic that could not be decoded, and how many there were
    drops: tuple[tuple[Drop, int], ...] = ()

    def lookup(self, dst: str, src: str) -> Transform:
        """T_dst_src over fixed transforms alone.

        Raises:
            FrameError: no fixed transforms join the frames; names faults and moving frames.
        """
        try:
            return self.fixed.lookup(dst, src)
        except FrameError as err:
            reasons = [f"{frame}: {self.faults[frame]}" for frame in sorted(self.faults)]
            ends = {self.fixed.root(src), self.fixed.root(dst)}
            frames = sorted(ends & set(self.moving)) or sorted(self.moving)[:MAX_MOVING_NAMED]
            reasons += [f"{frame} moves in {self.moving[frame]}" for frame in frames]
            raise FrameError("; ".join([str(err), *reasons])) from err

    def join_by_means(self, frames: Iterable[str]) -> None:
        """Use the mean poses of frames that sway, if fixed transforms alone do not join all of these frames."""
        named = [frame for frame in frames if frame]
        if not all(self.are_joined(named[0], one) for one in named):
            for sway in self.swaying.values():
                self.fixed.add_static(sway.mean)

    def are_joined(self, frame: str, other: str) -> bool:
        """Whether fixed transforms join two frames."""
        try:
            self.fixed.lookup(frame, other)
        except FrameError:
            return False
        return True


def clean_frame(name: str) -> str:
    """A frame name without the leading slash of old ROS 1 drivers."""
    return name.strip().lstrip("/")


def tf_topics(recording: Recording) -> tuple[list[str], list[str]]:
    """Topics of fixed transforms (`.../tf_static`) and of the others, each in order of name."""
    topics = sorted({info.topic for info in recording.topics if info.msgtype in TF_TYPES})
    static = [name for name in topics if name.rsplit("/", 1)[-1] == "tf_static"]
    return static, [name for name in topics if name not in static]


@decoder
def decode_transforms(
    message: RawMessage,
    *,
    limits: RecordingLimits = DEFAULT_LIMITS,
    is_wanted: Callable[[str, str], bool] = lambda _parent, _child: True,
) -> list[tuple[int, Transform | CalibrationError, str]]:
    """The transforms of one message: stamp in ns, T_parent_child or its fault, child frame.

    Sound ones of frames (parent, child) that are not wanted are left out, which saves most of the time.
    """
    stamped = deserialize_as(message, *sorted(TF_TYPES), limits=limits).transforms
    return [found for one in stamped if (found := _decode(one, is_wanted)) is not None]


def _decode(
    stamped: Any, is_wanted: Callable[[str, str], bool]
) -> tuple[int, Transform | CalibrationError, str] | None:
    parent, child = clean_frame(stamped.header.frame_id), clean_frame(stamped.child_frame_id)
    stamp_ns = stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec
    shift, turn = stamped.transform.translation, stamped.transform.rotation
    xyzw = [float(turn.x), float(turn.y), float(turn.z), float(turn.w)]
    if not parent or not child or parent == child:
        return stamp_ns, FrameError(f"transform from {child!r} to {parent!r}: expected two different frames"), child
    if not abs(sum(part * part for part in xyzw) - 1) <= QUATERNION_TOLERANCE:
        return stamp_ns, FrameError(f"its rotation {xyzw} is not a unit quaternion"), child
    if not is_wanted(parent, child) and isfinite(shift.x + shift.y + shift.z):
        return None
    try:
        return stamp_ns, _transform(parent, child, NUMBERS.pack(shift.x, shift.y, shift.z, *xyzw)), child
    except FrameError as err:
        return stamp_ns, err, child


@lru_cache(maxsize=256)
def _transform(parent: str, child: str, numbers: bytes) -> Transform:
    """Mountings are often sent again and again. Told apart by their bytes, since 0 equals -0."""
    values = NUMBERS.unpack(numbers)
    return Transform.from_quaternion(parent, child, values[:3], values[3:])


def read_transforms(
    recording: Recording,
    *,
    start_ns: int | None = None,
    stop_ns: int | None = None,
    limits: RecordingLimits = DEFAULT_LIMITS,
) -> RecordedTransforms:
    """All of /tf_static, and /tf at the start of the recording and at both ends of the time window (log times).

    `stop_ns` is excluded. What stands at first and is elsewhere at the end moves: a vehicle that drives off late.
    Messages of a topic that names more frames than `limits` allow are dropped from there on.
    """
    static, dynamic = tf_topics(recording)
    fixed = TransformTree()
    faults: dict[str, str] = {}
    drops: dict[str, tuple[Drop, int]] = {}
    sent: dict[str, Transform] = {}
    seen: dict[str, Transform] = {}
    moving: dict[str, str] = {}
    poses = defaultdict[str, list[F64]](list)
    moving_far, names, changed = set[str](), set[str](), set[str]()
    for message, transform, child in _transforms(recording.messages(static) if static else (), drops, names, limits):
        if not isinstance(transform, Transform):
            faults[child] = f"{transform} ({message.topic})"
            continue
        before, sent[child] = sent.get(child, transform), transform
        if _differ(before, transform, MAX_ROUNDED):
            changed.add(child)
        fixed.add_static(transform)

    def may_tell(parent: str, child: str) -> bool:
        """Whether a transform may say more than that its frame moves."""
        return moving.get(child) != parent or child not in moving_far

    beginnings = _beginnings(recording, dynamic, start_ns, stop_ns)
    for message, transform, child in _transforms(beginnings, drops, names, limits, is_wanted=may_tell):
        if not isinstance(transform, Transform):
            faults[child] = f"{transform} ({message.topic})"
        elif (known := fixed.edge(child)) is not None:
            if _differ(known, transform, MAX_ROUNDED):
                changed.add(child)
        else:
            first = seen.setdefault(child, transform)
            poses[child].append(transform.matrix)
            if _differ(first, transform) or transform.dst in ODOMETRY_FRAMES:
                moving[child] = transform.dst
            if _differ(first, transform, MAX_SWAY) or not GROUND_WORDS.isdisjoint(re.split("[/_]", transform.dst)):
                moving_far.add(child)
    end = _end(recording, dynamic, start_ns, stop_ns)
    for _, transform, child in _transforms(end, drops, names, limits, is_wanted=may_tell):
        if child in seen and isinstance(transform, Transform) and _differ(seen[child], transform):
            moving[child] = transform.dst
            moving_far |= {child} if _differ(seen[child], transform, MAX_SWAY) else set()
    for child, transform in seen.items():
        if child not in moving:
            fixed.add_static(transform)
    left = {child: reason for child, reason in faults.items() if fixed.edge(child) is None}
    swaying = {child: _sway(seen[child], np.array(poses[child])) for child in moving.keys() - moving_far}
    return RecordedTransforms(fixed, moving, left, frozenset(changed), swaying, tuple(drops.values()))


def _sway(first: Transform, poses: F64) -> Sway:
    """The sway of a frame by its poses (N, 4, 4)."""
    mean = poses.mean(axis=0)
    u, _, vt = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = u @ vt
    away = np.abs(poses - mean).max(axis=0)
    return Sway(replace(first, matrix=mean), float(np.degrees(away[:3, :3].max())), float(away[:3, 3].max()))


def _differ(one: Transform, other: Transform, limit: float = MAX_STILL_CHANGE) -> bool:
    return one.dst != other.dst or bool(np.abs(one.matrix - other.matrix).max() > limit)


def _beginnings(
    recording: Recording, topics: list[str], start_ns: int | None, stop_ns: int | None
) -> Iterator[RawMessage]:
    """The messages at the start of the recording and of the time window, each once."""
    if not topics:
        return
    if start_ns is None:
        span_ns = PROBE_NS if stop_ns is None else min(max(stop_ns - recording.start_ns, BEGINNING_NS), PROBE_NS)
        yield from _first_of(recording, topics, span_ns)
        return
    last: tuple[int, tuple[int, ...]] = (-1, ())
    for message in _first_of(recording, topics, BEGINNING_NS):
        last = message.log_time_ns, message.order
        yield message
    end_ns = start_ns + PROBE_NS if stop_ns is None else min(stop_ns, start_ns + PROBE_NS)
    for message in recording.messages(topics, start_ns=start_ns, stop_ns=end_ns):
        if (message.log_time_ns, message.order) > last:
            yield message


def _end(recording: Recording, topics: list[str], start_ns: int | None, stop_ns: int | None) -> Iterator[RawMessage]:
    """The last messages of the time window, where they lie behind all of its beginning that is read."""
    after_ns = min(stop_ns or recording.end_ns + 1, recording.end_ns + 1)
    if topics and after_ns - BEGINNING_NS > (start_ns or recording.start_ns) + PROBE_NS:
        yield from recording.messages(topics, start_ns=after_ns - BEGINNING_NS, stop_ns=after_ns)


def _first_of(recording: Recording, topics: list[str], span_ns: int) -> Iterator[RawMessage]:
    """The messages of the first `span_ns`.

    Where there is at most one, a wrong log time may lie far before all others, of this topic or of another one: then
    those of as long a time follow that begins with the next one. Otherwise no more is read, nor fetched from a server.
    """
    count = 0
    for message in recording.messages(topics, stop_ns=recording.start_ns + span_ns):
        count += 1
        yield message
    if count > 1:
        return
    begin_ns = None
    for message in islice(recording.messages(topics), count, None):
        begin_ns = message.log_time_ns if begin_ns is None else begin_ns
        if message.log_time_ns >= begin_ns + span_ns:
            return
        yield message


def _transforms(
    messages: Iterable[RawMessage],
    drops: dict[str, tuple[Drop, int]],
    names: set[str],
    limits: RecordingLimits,
    *,
    is_wanted: Callable[[str, str], bool] = lambda _parent, _child: True,
) -> Iterator[tuple[RawMessage, Transform | CalibrationError, str]]:
    read_bytes = 0
    for message in messages:
        read_bytes += len(message.data)
        if read_bytes > MAX_TF_BYTES:
            return
        try:
            for _, transform, child in decode_transforms(message, limits=limits, is_wanted=is_wanted):
                _add_frame(child, names, message.topic, limits)
                yield message, transform, child
        except MessageError as err:
            drop = Drop(message.topic, message.stamp_ns, "cannot be decoded", str(err))
            first, count = drops.get(message.topic, (drop, 0))
            drops[message.topic] = first, count + 1


def _add_frame(child: str, names: set[str], topic: str, limits: RecordingLimits) -> None:
    if child not in names and len(names) >= limits.max_frames:
        raise MessageError(f"{topic}: transforms of more than {limits.max_frames} coordinate frames: raise limit_scale")
    names.add(child)
