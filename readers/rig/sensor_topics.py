"""Topics of the lidars and cameras of a recording, and the calibration and boxes of each camera.

A topic is used if it has messages, the settings do not exclude it, and its name does not say ground truth, depth or
mask. Topics made of other topics (combined messages, combined clouds, maps, what nodes made of a sensor's: see
`derived`) are used only where those were not recorded. Images of one camera that were recorded several times (raw and
compressed, raw and rectified) count once. CameraInfo
and recorded boxes go to the camera of the same place (see `topic_names`), else to the one whose messages name the same
frame; among several by frame, then by the longest common beginning, then in order of name; a single one goes to a
single camera.
"""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import islice, pairwise
from statistics import median
from typing import NamedTuple

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits, TopicsConfig
from lidcam.readers.messages.compressed_cloud import COMPRESSED_CLOUDS
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.registry import types_of
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.natural_order import natural_key
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.derived.clouds import (
    COMPUTED_FIELDS,
    PACKETS,
    RADAR_FIELDS,
    cloud_sources,
    has_fields,
    is_measured,
    is_world_frame,
)
from lidcam.readers.rig.derived.contents import image_sources
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.topic_names import is_measured_image, is_truth, pair_score, place, transport_free
from lidcam.readers.rig.undecoded import undecoded
from lidcam.readers.video.packets import VIDEO

CLOUD, IMAGE = types_of("cloud"), types_of("image")
CAMERA_INFO, BOXES = types_of("camera info"), types_of("2D boxes")

MADE_OF_OTHERS = "/point_cloud_combined", "/ground_cloud"
"""Topics made of others, which are used only if no other topic of their kind was recorded."""

MADE = "made of the others"

OPTICAL = "optical", "optical_frame"
"""Ends of the names of frames of cameras (REP 103)."""

MANY = 10
"""Messages of a topic, beside which a single one of another topic is no sensor's."""

COMPARED_FRAMES = 4
"""Messages at the start of a topic of clouds whose frames are compared."""

MAX_RATE_HZ = 40.0
"""Maximum rate of whole sweeps; lidars turn up to 30 times per second."""

DEPTH_ENCODINGS = frozenset({"16UC1", "32FC1", "32SC1"})


@dataclass(frozen=True, slots=True)
class SensorFault:
    """A sensor that is left out, and why, in one line; `topic` is empty if unknown."""

    sensor: str
    topic: str
    reason: str

    @property
    def subject(self) -> str:
        """Name, with the topic if that is known."""
        return f"{self.sensor} ({self.topic})" if self.topic else self.sensor


def faults_told(faults: Iterable[SensorFault]) -> list[tuple[str, str]]:
    """Subjects and reason; those whose reasons differ in names in quotes alone follow the first one together."""
    alike: dict[str, list[SensorFault]] = {}
    for fault in faults:
        alike.setdefault(re.sub("'[^']*'", "", fault.reason), []).append(fault)
    told = []
    for first, *others in alike.values():
        told.append((first.subject, first.reason))
        told += [(", ".join(other.subject for other in others), "likewise")] if others else []
    return told


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings of the search for sensors."""

    faults: list[SensorFault] = field(default_factory=list)  # Sensors that are left out
    notes: list[str] = field(default_factory=list)  # Topics that are not used, and topics that were assigned by order

    def copy(self) -> "Findings":
        """The same findings, to which others can be added."""
        return Findings([*self.faults], [*self.notes])

    def leave_out(self, sensor: str, topic: str, reason: object) -> None:
        """Add a fault; its topic is not said twice."""
        self.faults.append(SensorFault(sensor, topic, str(reason).removeprefix(f"{topic}: ")))


class CameraTopics(NamedTuple):
    """The topics of one camera; empty if it has none."""

    image: str
    info: str = ""
    boxes: str = ""

    @property
    def topic(self) -> str:
        """The topic of its images, else of its boxes."""
        return self.image or self.boxes


def readable_topics(recording: Recording, msgtypes: frozenset[str]) -> set[str]:
    """Topics of these types that have messages and can be read."""
    return {i.topic for i in recording.topics if i.msgtype in msgtypes and i.message_count and not i.unreadable}


def find_lidar_topics(
    recording: Recording,
    config: TopicsConfig,
    first: FirstMessages,
    findings: Findings,
    transforms: RecordedTransforms | None = None,
    *,
    of_rig: Collection[str] = (),
) -> list[str]:
    """Topics of clouds, in natural order or as configured; those of the rig file (`of_rig`) were made of no other.

    Packets are not used where the clouds that the driver made of them were recorded. Without `transforms` none were
    recorded.
    """
    transforms = transforms or RecordedTransforms(TransformTree())
    if config.lidars is not None:
        return configured_topics(recording, config.lidars, CLOUD, "lidar", findings)
    recorded, notes = topics_with_messages(recording, CLOUD, config), findings.notes
    infos = [info for info in recorded if not info.unreadable]
    measured = [info for info in infos if is_measured_image(info.topic)]
    notes += [f"{info.topic}: not a lidar's by its name, not used" for info in infos if info not in measured]
    notes += [
        f"{info.topic}: {info.message_count} {info.gathered_from} gathered into sweeps"
        for info in infos
        if info.gathered_from
    ]
    notes += filter(None, (_piece_note(recording, info) for info in infos))
    notes += filter(None, (_frames_note(recording, info) for info in infos))
    excluded = config.exclude
    others = (one for one in recording.topics if not any(fnmatchcase(one.topic, name) for name in excluded))
    notes += undecoded(recording, others)
    before = len(notes)
    chosen = _first_hand(measured, notes, _hand_of_cloud(measured, first, transforms))
    unreadable = [info for info in recorded if info.unreadable]
    chosen = _readable(_before_copies([*chosen, *unreadable], first, notes), "lidar", findings)
    sources = cloud_sources(recording, chosen, first, transforms)
    for topic, source in sources.items():
        if source and not transforms.are_joined(first.frame(topic, CLOUD), first.frame(source, CLOUD)):
            sources[topic] += ", or of a lidar that no transform joins with it"
    return _sensors(sources, "lidars", notes, of_rig, was_choice=len(notes) > before)


def _piece_note(recording: Recording, info: TopicInfo) -> str:
    """The note on clouds that are pieces of sweeps, by their rate; empty for whole ones."""
    span_s = max(recording.end_ns - recording.start_ns, 1) * 1e-9
    if info.gathered_from or info.message_count <= MANY or info.message_count / span_s < MAX_RATE_HZ:
        return ""
    stamps_ns = sorted(message.stamp_ns for message in islice(recording.messages([info.topic]), MANY))
    period_s = median([after - before for before, after in pairwise(stamps_ns)] or [0]) * 1e-9  # log times may be odd
    if not 0 < period_s < 1 / MAX_RATE_HZ:
        return ""
    return (
        f"{info.topic}: {1 / period_s:.0f} clouds per second, so each is a piece of a sweep; objects are found in "
        "whole sweeps: let the driver publish 10 or 20 per second"
    )


def _frames_note(recording: Recording, info: TopicInfo) -> str:
    """The note on clouds of several lidars on one topic, by the frames of the first few; empty if they have one."""
    frames: dict[str, None] = {}
    for message in islice(recording.messages([info.topic]), COMPARED_FRAMES):
        if message.channel.msgtype == "sensor_msgs/msg/PointCloud2":
            with suppress(MessageError):
                frames[clean_frame(deserialize(message).header.frame_id)] = None
    frames.pop("", None)
    return (
        f"{info.topic}: its clouds are in the frames {', '.join(frames)}, but all get the pose of one lidar: record "
        "each lidar on a topic of its own"
        if len(frames) > 1
        else ""
    )


def find_camera_topics(
    recording: Recording,
    config: TopicsConfig,
    first: FirstMessages,
    findings: Findings,
    *,
    limits: RecordingLimits = DEFAULT_LIMITS,
    of_rig: Collection[str] = (),
) -> list[CameraTopics]:
    """Cameras, in natural order or as configured; those with boxes but no images come last.

    Images of the rig file (`of_rig`) were made of no others.
    """
    notes = findings.notes
    calibrations = sorted(readable_topics(recording, CAMERA_INFO), key=natural_key)
    boxes = [info.topic for info in topics_with_messages(recording, BOXES, config) if not info.unreadable]
    if config.cameras is not None:
        images = configured_topics(recording, config.cameras, IMAGE | BOXES, "camera", findings)
        named = [t for t in images if _types(recording, t) <= BOXES]
        images = [t for t in images if t not in named]
        boxes = [*dict.fromkeys([*named, *boxes])]
        only_boxes_allowed = set(config.cameras)
        notes += [] if config.cameras else ["topics.cameras is empty: no camera is used"]
    else:
        infos = _readable(topics_with_messages(recording, IMAGE, config), "camera", findings)
        images = _one_per_camera(_first_hand(infos, notes, _hand_of_image), first, notes)
        places = {place(topic) for topic in calibrations}
        sources = image_sources(recording, images, first, limits, has_info=lambda topic: place(topic) in places)
        images = _sensors(sources, "cameras", notes, of_rig)
        only_boxes_allowed = set(boxes)

    frames = {topic: first.frame(topic, IMAGE) for topic in images}
    frames |= {topic: first.frame(topic, BOXES) for topic in boxes}
    frames |= {topic: first.frame(topic, CAMERA_INFO) for topic in calibrations}
    boxes_of: dict[str, str] = {}
    alone: list[str] = []
    for topic in boxes:
        camera = _best(topic, images, frames, single=len(boxes) == 1)
        if camera and camera not in boxes_of:
            boxes_of[camera] = topic
        elif camera:
            notes.append(f"{topic}: {boxes_of[camera]} already has the boxes of {camera}, not used")
        elif topic in only_boxes_allowed:
            alone.append(topic)
    cameras = [(topic, boxes_of.get(topic, "")) for topic in images] + [("", topic) for topic in alone]
    return [
        CameraTopics(image, _best(image or boxes, calibrations, frames, single=len(cameras) == 1), boxes)
        for image, boxes in cameras
    ]


def topics_with_messages(recording: Recording, msgtypes: frozenset[str], config: TopicsConfig) -> list[TopicInfo]:
    """Topics of these types that have messages and neither are truth nor excluded, in natural order."""
    infos = [
        info
        for info in recording.topics
        if info.msgtype in msgtypes
        and info.message_count > 0
        and not is_truth(info.topic, info.msgtype)
        and not any(fnmatchcase(info.topic, pattern) for pattern in config.exclude)
    ]
    return sorted(infos, key=lambda info: natural_key(info.topic))


def _readable(infos: Iterable[TopicInfo], kind: str, findings: Findings) -> list[TopicInfo]:
    """Readable topics; the others become faults."""
    readable = []
    for info in infos:
        if info.unreadable:
            findings.leave_out(kind, info.topic, info.unreadable)
        else:
            readable.append(info)
    return readable


def configured_topics(
    recording: Recording, topics: Iterable[str], msgtypes: frozenset[str], kind: str, findings: Findings
) -> list[str]:
    """Topics of the settings that the recording has; the others become faults."""
    there = readable_topics(recording, msgtypes)
    names = ", ".join(sorted(there, key=natural_key)) or "none"
    for topic in topics:
        if topic not in there:
            reason = f"the settings name it, but the recording has no such topic of a {kind}; it has {names}"
            findings.leave_out(kind, topic, reason)
    return [topic for topic in dict.fromkeys(topics) if topic in there]


def _first_hand(
    infos: Sequence[TopicInfo], notes: list[str], hand: Callable[[TopicInfo], tuple[int, str]]
) -> list[TopicInfo]:
    """Topics of the first hand; those of a later one are noted, with the reason that `hand` returns beside its number.

    A recording of a whole system has the sensors' messages and also what its nodes made of them.
    """
    found = {info: hand(info) for info in infos}
    first = min((number for number, _ in found.values()), default=0)
    notes += [f"{info.topic}: {reason}, not used" for info, (number, reason) in found.items() if number > first]
    return [info for info in infos if found[info][0] == first]


def _hand_of_image(info: TopicInfo) -> tuple[int, str]:
    return (1, MADE) if info.part_of else (0, "")


def _hand_of_cloud(
    infos: Sequence[TopicInfo], first: FirstMessages, transforms: RecordedTransforms
) -> Callable[[TopicInfo], tuple[int, str]]:
    """Clouds recorded by themselves, parts of combined messages, those made of others, computed ones, and maps."""
    frames = {info.topic: first.frame(info.topic, CLOUD) for info in infos}
    most = max((info.message_count for info in infos), default=0)

    def hand(info: TopicInfo) -> tuple[int, str]:
        frame = frames[info.topic]
        if is_world_frame(frame, frames.values(), transforms, is_measured=is_measured(info.topic, first)):
            return 4, f"in {frame}, which is no frame of a sensor"
        others = [other for topic, other in frames.items() if topic != info.topic]
        if info.message_count == 1 and most >= MANY and not any(transforms.are_joined(frame, one) for one in others):
            return 4, "a single message"
        if frame.endswith(OPTICAL):
            return 3, f"in {frame}, the frame of a camera"
        for fields, whose in ((COMPUTED_FIELDS, "computed ones"), (RADAR_FIELDS, "a radar's")):
            if has_fields(info.topic, first, fields):
                return 3, f"its fields are {whose}"
        return (2, MADE) if info.topic in MADE_OF_OTHERS else (1, MADE) if info.part_of else (0, "")

    return hand


def _sensors(
    sources: Mapping[str, str], kind: str, notes: list[str], of_rig: Collection[str], *, was_choice: bool = False
) -> list[str]:
    """The topics that were not made of others, in natural order; notes name the others, and how to choose."""
    made = [topic for topic in sources if sources[topic] and topic not in of_rig]
    notes += [f"{topic}: made of {sources[topic]}, not used" for topic in sorted(made, key=natural_key)]
    sensors = sorted((topic for topic in sources if topic not in made), key=natural_key)
    if made or was_choice:
        notes.append(f"{kind}: {', '.join(sensors)}; to choose others: --set 'topics.{kind}=[{','.join(sensors)}]'")
    return sensors


def _before_copies(infos: Sequence[TopicInfo], first: FirstMessages, notes: list[str]) -> list[TopicInfo]:
    """Without compressed copies, and without packets of a place or frame that has clouds.

    The driver made those with its own calibration.
    """
    clouds = [info.topic for info in infos if info.msgtype not in PACKETS and info.msgtype not in COMPRESSED_CLOUDS]
    chosen: list[TopicInfo] = []
    for info in infos:
        topic, frame, reason = info.topic, "", "compressed, the same clouds as"
        if info.msgtype in PACKETS:
            frame, reason = first.frame(topic, CLOUD), "packets of the same lidar as"
        same = (t for t in clouds if place(t) == place(topic) or (frame and first.frame(t, CLOUD) == frame))
        if topic not in clouds and (cloud := next(same, "")):
            notes.append(f"{topic}: {reason} {cloud}, not used")
        else:
            chosen.append(info)
    return chosen


def _types(recording: Recording, topic: str) -> set[str]:
    return {info.msgtype for info in recording.topics if info.topic == topic}


def _one_per_camera(infos: Sequence[TopicInfo], first: FirstMessages, notes: list[str]) -> list[str]:
    """Image topics, depth images excepted; of several of one camera the least processed one."""
    chosen: dict[tuple[object, ...], str] = {}
    for info in sorted(infos, key=lambda info: (_processing(info), natural_key(info.topic))):
        frame = first.frame(info.topic, IMAGE)
        if not is_measured_image(info.topic) or _is_depth(info, first):
            notes.append(f"{info.topic}: depth or mask images, not used")
            continue
        by_topic, by_frame = (transport_free(info.topic),), (place(info.topic), frame)
        kept = chosen.get(by_topic) or (chosen.get(by_frame) if frame else None)
        if kept:
            notes.append(f"{info.topic}: images of the same camera as {kept}, not used")
        else:
            chosen[by_topic] = chosen[by_frame] = info.topic
    return sorted(set(chosen.values()), key=natural_key)


def _processing(info: TopicInfo) -> tuple[bool, bool, int]:
    words = transport_free(info.topic).lower().rpartition("/")[2].split("_")
    steps = 0 if "raw" in words else 2 if "rect" in words else 3 if "mono" in words else 1
    return info.msgtype in VIDEO, info.msgtype.endswith("CompressedImage"), steps


def _is_depth(info: TopicInfo, first: FirstMessages) -> bool:
    if info.msgtype.endswith("CompressedImage") or first.missing(info.topic, IMAGE):
        return False
    encoding = getattr(first.decoded(info.topic, IMAGE), "encoding", "")  # FFMPEGPacket: of the video; of the image
    return not DEPTH_ENCODINGS.isdisjoint(encoding.split(";"))


def _best(topic: str, others: Sequence[str], frames: dict[str, str], *, single: bool) -> str:
    """The topic of `others` that belongs to the same camera; empty if none does."""
    if not others:
        return ""
    scores = {
        other: pair_score(topic, other, same_frame=bool(frames[topic]) and frames[topic] == frames[other])
        for other in sorted(others, key=natural_key)
    }
    best = max(scores, key=lambda other: scores[other])  # the first of equals
    if scores[best][0] > 0:
        return best
    return best if single and len(others) == 1 else ""
