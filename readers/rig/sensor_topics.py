"""Topics of the lidars and cameras of a recording, and the calibration and boxes of each camera.

A topic is used if it has messages, the settings do not exclude it, and its name does not say ground truth, depth or
mask. Topics made of other topics (combined messages, combined clouds) are used only where those were not recorded.
Images of one camera that were recorded several times (raw and compressed, raw and rectified) count once. CameraInfo
and recorded boxes go to the camera of the same place (see `topic_names`), else to the one whose messages name the same
frame; among several by frame, then by the longest common beginning, then in order of name; a single one goes to a
single camera.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

from lidcam.pipeline.core.settings.recording import TopicsConfig
from lidcam.readers.messages.registry import types_of
from lidcam.readers.natural_order import natural_key
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.topic_names import is_measured_image, is_truth, pair_score, place, transport_free
from lidcam.readers.velodyne.scan import SCAN
from lidcam.readers.video.packets import VIDEO

CLOUD, IMAGE = types_of("cloud"), types_of("image")
CAMERA_INFO, BOXES = types_of("camera info"), types_of("2D boxes")
MADE_OF_OTHERS = "/point_cloud_combined", "/ground_cloud"
"""Topics made of others, which are used only if no other topic of their kind was recorded."""

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


@dataclass(frozen=True, slots=True)
class Findings:
    """Findings of the search for sensors."""

    faults: list[SensorFault] = field(default_factory=list)  # Sensors that are left out
    notes: list[str] = field(default_factory=list)  # Topics that are not used, and topics that were assigned by order

    def copy(self) -> "Findings":
        """The same findings, to which others can be added."""
        return Findings([*self.faults], [*self.notes])

    def leave_out(self, sensor: str, topic: str, reason: object) -> None:
        """Add a fault."""
        self.faults.append(SensorFault(sensor, topic, str(reason)))


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
    recording: Recording, config: TopicsConfig, first: FirstMessages, findings: Findings
) -> list[str]:
    """Topics of clouds, in natural order or as configured.

    Packets are not used where the clouds that the driver made of them were recorded.
    """
    if config.lidars is not None:
        return configured_topics(recording, config.lidars, CLOUD, "lidar", findings)
    infos = _readable(topics_with_messages(recording, CLOUD, config), "lidar", findings)
    measured = [info for info in infos if is_measured_image(info.topic)]
    notes = findings.notes
    notes += [f"{info.topic}: a depth camera's cloud, not used" for info in infos if info not in measured]
    notes += [
        f"{info.topic}: {info.message_count} {info.gathered_from} gathered into sweeps"
        for info in infos
        if info.gathered_from
    ]
    chosen = _first_hand(measured, notes)
    return [info.topic for info in _clouds_before_packets(chosen, first, notes)]


def find_camera_topics(
    recording: Recording, config: TopicsConfig, first: FirstMessages, findings: Findings
) -> list[CameraTopics]:
    """Cameras, in natural order or as configured; those with boxes but no images come last."""
    notes = findings.notes
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
        images = _one_per_camera(_first_hand(infos, notes), first, notes)
        only_boxes_allowed = set(boxes)
    calibrations = sorted(readable_topics(recording, CAMERA_INFO), key=natural_key)

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
    single = len(images) + len(alone) == 1
    cameras = [
        CameraTopics(topic, _best(topic, calibrations, frames, single=single), boxes_of.get(topic, ""))
        for topic in images
    ]
    for topic in alone:
        if info := _best(topic, calibrations, frames, single=single):
            cameras.append(CameraTopics("", info, topic))
        else:
            notes.append(f"{topic}: boxes of a camera without images and without CameraInfo, not used")
    return cameras


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
    wanted = " or ".join(sorted(msgtypes))
    for topic in topics:
        if topic not in there:
            reason = f"the settings name it, but the recording has no such {wanted}; it has {names}"
            findings.leave_out(kind, topic, reason)
    return [topic for topic in dict.fromkeys(topics) if topic in there]


def _first_hand(infos: Sequence[TopicInfo], notes: list[str]) -> list[TopicInfo]:
    """Topics that were recorded by themselves, else parts of combined messages, else those made of others.

    A recording of a whole system has the sensors' messages and also what its nodes made of them.
    """

    def hand(info: TopicInfo) -> int:
        return 2 if info.topic in MADE_OF_OTHERS else 1 if info.part_of else 0

    best = min(map(hand, infos), default=0)
    notes += [f"{info.topic}: made of the others, not used" for info in infos if hand(info) > best]
    return [info for info in infos if hand(info) == best]


def _clouds_before_packets(infos: Sequence[TopicInfo], first: FirstMessages, notes: list[str]) -> list[TopicInfo]:
    """Without packets of a place or frame that has clouds: the driver made those with its own calibration."""
    clouds = [info.topic for info in infos if info.msgtype != SCAN]
    chosen: list[TopicInfo] = []
    for info in infos:
        if info.msgtype == SCAN and clouds:
            frame = first.frame(info.topic, CLOUD)
            same = (t for t in clouds if place(t) == place(info.topic) or (frame and first.frame(t, CLOUD) == frame))
            if cloud := next(same, ""):
                notes.append(f"{info.topic}: packets of the same lidar as {cloud}, not used")
                continue
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
