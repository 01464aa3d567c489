"""Choice of the topics of a recording that a run copies to its output."""

from collections.abc import Collection, Iterable
from fnmatch import fnmatchcase
from pathlib import Path

from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.detections import DETECTIONS_3D
from lidcam.readers.messages.tf import ODOMETRY
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.topic_names import is_truth
from lidcam.readers.truth.topics import WHEN_MEASURED
from lidcam.writers.mcap.writer import reserved_topics
from lidcam.writers.messages.scene import truth_scene_topic

ROS_ENCODINGS = frozenset({"ros1", "cdr"})


def choose_copied(
    outputs: Iterable[Path], recording: Recording, rig: Rig, config: Config
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The topics to copy, in order of name, and what the user should know of those that are not.

    Without an MCAP output nothing is copied.
    """
    if not any(path.suffix == ".mcap" for path in outputs):
        return (), ()
    notes: list[str] = []
    patterns = config.output.copy_topics
    recorded = [info for info in recording.topics if info.message_count]
    if patterns is None:
        of_rig = {vehicle.topic for vehicle in rig.truth.values()}
        wanted = [info for info in recorded if info.topic in of_rig or is_truth(info.topic, info.msgtype)]
    else:
        wanted = [info for info in recorded if any(fnmatchcase(info.topic, pattern) for pattern in patterns)]
        notes = [
            f"output.copy_topics: no topic with messages is called {pattern}"
            for pattern in dict.fromkeys(patterns)
            if not any(fnmatchcase(info.topic, pattern) for info in recorded)
        ]
    drawn = {truth_scene_topic(topic) for topic in choose_drawn(recording, {info.topic for info in wanted})}
    if patterns is None:
        wanted = [info for info in wanted if info.topic not in drawn]  # the recording is a result: drawn anew
    reserved = reserved_topics(rig) | drawn
    copied: dict[str, None] = {}
    for info in wanted:
        if problem := _problem(info, reserved):
            notes.append(f"{info.topic} is not copied to the output: {problem}")
        else:
            copied[info.topic] = None
    return tuple(copied), tuple(notes)


def choose_drawn(recording: Recording, copied: Collection[str]) -> tuple[str, ...]:
    """The copied topics whose boxes are drawn: truth in 3D, each object once."""
    return tuple(
        info.topic
        for info in recording.topics
        if info.topic in copied
        and info.msgtype == DETECTIONS_3D
        and is_truth(info.topic, info.msgtype)
        and not info.topic.endswith(WHEN_MEASURED)
    )


def truth_frames(
    recording: Recording, copied: Collection[str], found: Discovery, config: Config
) -> tuple[Transform, ...]:
    """T_site_frame of the fixed frames in which copied boxes and odometry stand, so that the result joins them, too."""
    rig, first = found.rig, FirstMessages(recording, limits=config.limits)
    known = {
        rig.site_frame,
        *(one.T_site_lidar.src for one in rig.lidars),
        *(one.T_camera_site.dst for one in rig.cameras),
    }
    frames: dict[str, Transform] = {}
    for info in recording.topics:
        if info.topic not in copied or info.msgtype not in (DETECTIONS_3D, ODOMETRY):
            continue
        frame = first.frame(info.topic, {info.msgtype})
        if frame and frame not in known and found.transforms.are_joined(rig.site_frame, frame):
            frames[frame] = found.transforms.lookup(rig.site_frame, frame)
    return tuple(frames.values())


def _problem(info: TopicInfo, reserved: frozenset[str]) -> str:
    """Why a topic cannot be copied; empty if it can."""
    if info.topic in reserved:
        return "the result has a topic of that name"
    if info.unreadable:
        return info.unreadable
    if foreign := [channel.encoding for channel in info.channels if channel.encoding not in ROS_ENCODINGS]:
        return f"its messages are {foreign[0]}, expected ROS messages"
    return ""
