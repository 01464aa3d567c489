"""Topics of the recording for the sensors of a rig file.

A sensor with a topic has that topic, or, if the same images were recorded compressed or not compressed, that one. A
sensor without gets the topic of its own place (`camera_11` and `cam11` are `/image_raw_11`). The rest get the topics
that are left, in the order of the file and the natural order of the topics, and that is noted. A sensor for which no
topic is left is left out.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple, TypeVar

from lidcam.readers.recording import Recording
from lidcam.readers.rig.schema import CameraEntry, LidarEntry
from lidcam.readers.rig.sensor_topics import BOXES, CLOUD, IMAGE, CameraTopics, Findings, readable_topics
from lidcam.readers.rig.topic_names import place, sensor_names, transport_free

E = TypeVar("E", LidarEntry, CameraEntry)


class AssignedLidar(NamedTuple):
    """A lidar, its topic and its entry in the rig file."""

    name: str
    topic: str
    entry: LidarEntry


class AssignedCamera(NamedTuple):
    """A camera, its topics and its entry in the rig file."""

    name: str
    topics: CameraTopics
    entry: CameraEntry

    @property
    def topic(self) -> str:
        """The topic of its images, else of its boxes."""
        return self.topics.topic


def assign_lidars(
    entries: Mapping[str, LidarEntry] | None, topics: Sequence[str], recording: Recording, findings: Findings
) -> list[AssignedLidar]:
    """Lidars in the order of the rig file; without `entries` all, in the order of the topics."""
    if entries is None:
        names = sensor_names(topics, "lidar")
        return [AssignedLidar(names[topic], topic, LidarEntry()) for topic in topics]
    recorded = readable_topics(recording, CLOUD)
    chosen = _assign(entries, topics, lambda entry: entry.topic, recorded, "clouds", findings)
    return [AssignedLidar(name, topic, entries[name]) for name, topic in chosen.items()]


def assign_cameras(
    entries: Mapping[str, CameraEntry] | None,
    cameras: Sequence[CameraTopics],
    recording: Recording,
    findings: Findings,
    *,
    taken: Collection[str],
) -> list[AssignedCamera]:
    """Cameras in the order of the rig file; without `entries` all, in the order of the topics, named unlike `taken`."""
    by_topic = {camera.topic: camera for camera in cameras}
    if entries is None:
        names = sensor_names([*by_topic], "camera", taken=taken)
        return [AssignedCamera(names[topic], topics, CameraEntry()) for topic, topics in by_topic.items()]
    recorded = readable_topics(recording, IMAGE | BOXES)
    chosen = _assign(
        entries, [*by_topic], lambda entry: entry.topic or entry.boxes_topic, recorded, "images or boxes", findings
    )
    boxes = readable_topics(recording, BOXES)
    assigned = []
    for name, topic in chosen.items():
        entry = entries[name]
        alone = CameraTopics("", "", topic) if topic in boxes else CameraTopics(topic)
        topics = by_topic.get(topic, alone)
        if entry.boxes_topic and entry.boxes_topic not in boxes:
            findings.notes.append(f"{name}: the recording has no boxes on {entry.boxes_topic}")
        elif entry.boxes_topic:
            topics = topics._replace(boxes=entry.boxes_topic)
        assigned.append(AssignedCamera(name, topics, entry))
    return assigned


def _as_recorded(topic: str, topics: Sequence[str], recorded: Collection[str]) -> str:
    """The topic, or the one by which the same images were recorded, compressed or not; itself if there is none."""
    if topic in recorded:
        return topic
    same = [other for other in topics if transport_free(other) == transport_free(topic)]
    return same[0] if len(same) == 1 else topic


def _assign(
    entries: Mapping[str, E],
    topics: Sequence[str],
    topic_of: Callable[[E], str],
    recorded: Collection[str],
    what: str,
    findings: Findings,
) -> dict[str, str]:
    """Topic by sensor, in the order of the entries."""
    chosen: dict[str, str] = {}
    for name, entry in entries.items():
        if not (named := topic_of(entry)):
            continue
        topic = _as_recorded(named, topics, recorded)
        if topic not in recorded:
            findings.leave_out(name, topic, f"the recording has no {what} on this topic")
        elif topic in chosen.values():
            findings.leave_out(name, topic, "another sensor of the rig file has this topic")
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
        findings.notes.append(f"{name}: has no topic in the rig file; by order it is {topic}")
    for name in left[len(free) :]:
        findings.leave_out(name, "", "the recording has no topic left for it")
    if entries and (others := free[len(left) :]):
        findings.notes.append(f"not used, as the rig file names others alone: {', '.join(others)}")
    return {name: chosen[name] for name in entries if name in chosen}
