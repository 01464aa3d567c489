"""Selecting the topics of sensors: what was found, what is left out, and why.

A topic is used if it has messages, the settings do not exclude it, and its name does not say ground truth, depth or
mask. `topics` finds those of lidars and cameras.
"""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import NamedTuple

from lidcam.pipeline.core.settings.recording import TopicsConfig
from lidcam.readers.messages.registry import types_of
from lidcam.readers.natural_order import natural_key
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.topic_names import is_truth

CLOUD, IMAGE = types_of("cloud"), types_of("image")
CAMERA_INFO, BOXES = types_of("camera info"), types_of("2D boxes")

MADE = "made of the others"

OPTICAL = "optical", "optical_frame"
"""Ends of the names of frames of cameras (REP 103)."""


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


def is_excluded(topic: str, config: TopicsConfig) -> bool:
    """Whether the settings exclude a topic."""
    return any(fnmatchcase(topic, pattern) for pattern in config.exclude)


def topics_with_messages(recording: Recording, msgtypes: frozenset[str], config: TopicsConfig) -> list[TopicInfo]:
    """Topics of these types that have messages and neither are truth nor excluded, in natural order."""
    infos = [
        info
        for info in recording.topics
        if info.msgtype in msgtypes
        and info.message_count > 0
        and not is_truth(info.topic, info.msgtype)
        and not is_excluded(info.topic, config)
    ]
    return sorted(infos, key=lambda info: natural_key(info.topic))


def readable(infos: Sequence[TopicInfo], kind: str, findings: Findings) -> list[TopicInfo]:
    """Readable topics; the others become faults."""
    for info in infos:
        if info.unreadable:
            findings.leave_out(kind, info.topic, info.unreadable)
    return [info for info in infos if not info.unreadable]


def configured_topics(
    recording: Recording, topics: Iterable[str], msgtypes: frozenset[str], kind: str, findings: Findings
) -> list[str]:
    """Topics of the settings that the recording has; the others become faults."""
    there = readable_topics(recording, msgtypes)
    shown = {info.topic for info in recording.topics if not is_truth(info.topic, info.msgtype)} & there
    names = ", ".join(sorted(shown, key=natural_key)) or "none"
    for topic in topics:
        if topic not in there:
            reason = f"the settings name it, but the recording has no {kind} topic of this name; it has {names}"
            findings.leave_out(kind, topic, reason)
    return [topic for topic in dict.fromkeys(topics) if topic in there]


def first_hand(
    infos: Sequence[TopicInfo], notes: list[str], hand: Callable[[TopicInfo], tuple[int, str]]
) -> list[TopicInfo]:
    """Topics of the first hand; those of a later one are noted, with the reason that `hand` returns beside its number.

    A recording of a whole system has the sensors' messages and also what its nodes made of them.
    """
    found = {info: hand(info) for info in infos}
    first = min((number for number, _ in found.values()), default=0)
    notes += [f"{info.topic}: {reason}, not used" for info, (number, reason) in found.items() if number > first]
    return [info for info in infos if found[info][0] == first]


def sensors_of(
    sources: Mapping[str, str], kind: str, notes: list[str], of_rig: Collection[str], *, was_choice: bool = False
) -> list[str]:
    """The topics that were not made of others, in natural order; notes name the others, and how to choose."""
    made = [topic for topic in sources if sources[topic] and topic not in of_rig]
    notes += [f"{topic}: made of {sources[topic]}, not used" for topic in sorted(made, key=natural_key)]
    sensors = sorted((topic for topic in sources if topic not in made), key=natural_key)
    if sensors and (made or was_choice):
        notes.append(f"{kind}: {', '.join(sensors)}; to choose others: --set 'topics.{kind}=[{','.join(sensors)}]'")
    return sensors
