"""Topics of the lidars of a recording.

Topics made of other topics (combined clouds, maps, what nodes made of a sensor's: see `clouds`) are used only where
those were not recorded.
"""

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from itertools import islice, pairwise
from statistics import median

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.settings.recording import TopicsConfig
from lidcam.readers.messages.compressed_cloud import COMPRESSED_CLOUDS
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import (
    CLOUD,
    MADE,
    OPTICAL,
    Findings,
    configured_topics,
    first_hand,
    is_excluded,
    readable,
    sensors_of,
    topics_with_messages,
)
from lidcam.readers.rig.topic_names import is_measured_image, place
from lidcam.readers.rig.topics.clouds import (
    COMPUTED_FIELDS,
    PACKETS,
    RADAR_FIELDS,
    cloud_sources,
    has_fields,
    is_measured,
    is_world_frame,
)
from lidcam.readers.rig.undecoded import undecoded

MADE_OF_OTHERS = "/point_cloud_combined", "/ground_cloud"
"""Topics made of others, which are used only if no other topic of their kind was recorded."""

MANY = 10
"""Messages of a topic, beside which a single one of another topic is no sensor's."""

COMPARED = 4
"""Messages at the start of a topic of clouds whose frames, and numbers of points, are compared."""

FEW_POINTS, FEW_OF_MOST = 500, 0.05
"""Smallest number of points of a lidar's clouds beside larger ones, and smallest share of the largest cloud's."""

MAX_RATE_HZ = 40.0
"""Maximum rate of whole sweeps; lidars turn up to 30 times per second."""


def find_lidar_topics(
    recording: Recording,
    config: TopicsConfig,
    first: FirstMessages,
    findings: Findings,
    transforms: RecordedTransforms,
    *,
    of_rig: Collection[str] = (),
) -> list[str]:
    """Topics of clouds, in natural order or as configured; those of the rig file (`of_rig`) were made of no other.

    Packets are not used where the clouds that the driver made of them were recorded.
    """
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
    notes += filter(None, (note(recording, info) for note in (_piece_note, _frames_note) for info in infos))
    notes += undecoded(recording, (one for one in recording.topics if not is_excluded(one.topic, config)))
    before = len(notes)
    chosen = first_hand(measured, notes, _hand_of_cloud(recording, measured, first, transforms))
    unreadable = [info for info in recorded if info.unreadable]
    chosen = readable(_before_copies([*chosen, *unreadable], first, notes), "lidar", findings)
    sources = cloud_sources(recording, chosen, first, transforms)
    for topic, source in sources.items():
        if source and not transforms.are_joined(first.frame(topic, CLOUD), first.frame(source, CLOUD)):
            sources[topic] += ", or of a lidar that no transform joins with it"
    return sensors_of(sources, "lidars", notes, of_rig, was_choice=len(notes) > before or infos != measured)


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
    for message in islice(recording.messages([info.topic]), COMPARED):
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


def _hand_of_cloud(
    recording: Recording, infos: Sequence[TopicInfo], first: FirstMessages, transforms: RecordedTransforms
) -> Callable[[TopicInfo], tuple[int, str]]:
    """Clouds recorded by themselves, parts of combined messages, those made of others, computed ones, and maps."""
    frames = {info.topic: first.frame(info.topic, CLOUD) for info in infos}
    most = max((info.message_count for info in infos), default=0)
    counts = {info.topic: math.prod(first.image_size(info.topic, CLOUD) or (0, 0)) for info in infos}
    few = min(FEW_POINTS, FEW_OF_MOST * max(counts.values(), default=0))

    def has_few_points(topic: str) -> bool:
        if counts[topic] >= few or is_measured(topic, first):
            return False
        with suppress(MessageError):
            return all(len(first.cloud(one)) < few for one in islice(recording.messages([topic]), COMPARED))
        return False

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
        if has_few_points(info.topic):
            return 3, f"fewer than {few:.0f} points in a cloud"
        return (2, MADE) if info.topic in MADE_OF_OTHERS else (1, MADE) if info.part_of else (0, "")

    return hand


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
