"""Which sensor of a rig file is which topic of the recording.

A sensor with a topic has that topic. One without gets the topic of its own place (`camera_11` and `cam11` are
`/image_raw_11`); those still left get the topics still left, in the order of the file and in natural order of the
topics, and that is noted. Sensors beyond the last topic are noted and left out.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from readers.recording import Recording
from readers.rig.rig_file import CameraEntry, LidarEntry
from readers.rig.sensor_topics import BOXES, CLOUD, IMAGE, CameraTopics, SensorFault
from readers.rig.topic_names import place, sensor_names

__all__ = ["AssignedCamera", "AssignedLidar", "Assignment", "assign_cameras", "assign_lidars"]

E = TypeVar("E", LidarEntry, CameraEntry)


@dataclass(frozen=True, slots=True)
class AssignedLidar:
    """A lidar's name, topic, and what the rig file says of it."""

    name: str
    topic: str
    entry: LidarEntry


@dataclass(frozen=True, slots=True)
class AssignedCamera:
    """A camera's name, topics, and what the rig file says of it."""

    name: str
    topics: CameraTopics
    entry: CameraEntry


@dataclass(frozen=True, slots=True)
class Assignment:
    """What was found wrong, and what was assumed."""

    faults: list[SensorFault] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def assign_lidars(
    entries: Mapping[str, LidarEntry] | None, topics: Sequence[str], recording: Recording
) -> tuple[list[AssignedLidar], Assignment]:
    """Lidars in the order of the rig file, without one in that of the topics."""
    if entries is None:
        names = sensor_names(topics, "lidar")
        return [AssignedLidar(names[topic], topic, LidarEntry()) for topic in topics], Assignment()
    result = Assignment()
    chosen = _assign(entries, topics, lambda entry: entry.topic, _topics_of(recording, CLOUD), "clouds", result)
    return [AssignedLidar(name, topic, entries[name]) for name, topic in chosen.items()], result


def assign_cameras(
    entries: Mapping[str, CameraEntry] | None,
    cameras: Sequence[CameraTopics],
    recording: Recording,
    *,
    taken: Collection[str],
) -> tuple[list[AssignedCamera], Assignment]:
    """Cameras in the order of the rig file, without one in that of the topics; no name is one of `taken`."""
    by_topic = {camera.topic: camera for camera in cameras}
    if entries is None:
        names = sensor_names([*by_topic], "camera", taken=taken)
        return [AssignedCamera(names[topic], topics, CameraEntry()) for topic, topics in by_topic.items()], Assignment()
    result = Assignment()
    recorded = _topics_of(recording, IMAGE | BOXES)
    chosen = _assign(
        entries, [*by_topic], lambda entry: entry.topic or entry.boxes_topic, recorded, "images or boxes", result
    )
    boxes = _topics_of(recording, BOXES)
    assigned = []
    for name, topic in chosen.items():
        entry = entries[name]
        alone = CameraTopics("", "", topic) if topic in boxes else CameraTopics(topic)
        topics = by_topic.get(topic, alone)
        if entry.boxes_topic and entry.boxes_topic not in boxes:
            result.notes.append(f"{name}: the recording has no boxes on {entry.boxes_topic}")
        elif entry.boxes_topic:
            topics = replace(topics, boxes=entry.boxes_topic)
        assigned.append(AssignedCamera(name, topics, entry))
    return assigned, result


def _topics_of(recording: Recording, msgtypes: frozenset[str]) -> set[str]:
    return {i.topic for i in recording.topics if i.msgtype in msgtypes and i.message_count and not i.unreadable}


def _assign(
    entries: Mapping[str, E],
    topics: Sequence[str],
    topic_of: Callable[[E], str],
    recorded: Collection[str],
    what: str,
    result: Assignment,
) -> dict[str, str]:
    """Topic by sensor, in the order of the entries."""
    chosen: dict[str, str] = {}
    for name, entry in entries.items():
        if not (topic := topic_of(entry)):
            continue
        if topic not in recorded:
            result.faults.append(SensorFault(name, topic, f"the recording has no {what} on this topic"))
        elif topic in chosen.values():
            result.faults.append(SensorFault(name, topic, "another sensor of the rig file has this topic"))
        else:
            chosen[name] = topic
    free = [topic for topic in topics if topic not in chosen.values()]
    unnamed = [name for name, entry in entries.items() if not topic_of(entry)]
    short = sensor_names(free, "camera")
    for name in unnamed:
        match = next((t for t in free if name == short[t] or place(f"/{name}/image") == place(t)), None)
        if match:
            chosen[name] = match
            free.remove(match)
    left = [name for name in unnamed if name not in chosen]
    for name, topic in zip(left, free, strict=False):
        chosen[name] = topic
        result.notes.append(f"{name}: has no topic in the rig file; by order it is {topic}")
    result.notes.extend(f"{name}: the recording has no topic left for it" for name in left[len(free) :])
    return {name: chosen[name] for name in entries if name in chosen}
