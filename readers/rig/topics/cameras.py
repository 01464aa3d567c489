"""Topics of the cameras of a recording, with the calibration and the boxes of each.

Images of one camera that were recorded several times (raw and compressed, raw and rectified) count once. CameraInfo and
recorded boxes go to the camera of the same place (see `topic_names`), else to the one whose messages name the same
frame; among several by frame, then by the longest common beginning, then in order of name; a single one goes to a
single camera.
"""

from collections.abc import Collection, Sequence

from lidcam.pipeline.core.settings.recording import DEFAULT_LIMITS, RecordingLimits, TopicsConfig
from lidcam.readers.natural_order import natural_key
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import (
    BOXES,
    CAMERA_INFO,
    IMAGE,
    MADE,
    CameraTopics,
    Findings,
    configured_topics,
    first_hand,
    readable,
    readable_topics,
    sensors_of,
    topics_with_messages,
)
from lidcam.readers.rig.topic_names import is_measured_image, pair_score, place, transport_free
from lidcam.readers.rig.topics.contents import image_sources
from lidcam.readers.video.packets import VIDEO

DEPTH_ENCODINGS = frozenset({"16UC1", "32FC1", "32SC1"})


def find_camera_topics(
    recording: Recording,
    config: TopicsConfig,
    first: FirstMessages,
    findings: Findings,
    *,
    limits: RecordingLimits = DEFAULT_LIMITS,
    lidar_frames: Collection[str] = (),
    of_rig: Collection[str] = (),
) -> list[CameraTopics]:
    """Cameras, in natural order or as configured; those with boxes but no images come last.

    Images of the rig file (`of_rig`) were made of no others, nor of the points of lidars, as in `lidar_frames`.
    """
    notes = findings.notes
    calibrations = sorted(readable_topics(recording, CAMERA_INFO), key=natural_key)
    boxes = [info.topic for info in topics_with_messages(recording, BOXES, config) if not info.unreadable]
    frames = {topic: first.frame(topic, CAMERA_INFO) for topic in calibrations}
    if config.cameras is not None:
        images = configured_topics(recording, config.cameras, IMAGE | BOXES, "camera", findings)
        named = [topic for topic in images if topic not in readable_topics(recording, IMAGE)]
        images = [t for t in images if t not in named]
        boxes = [*dict.fromkeys([*named, *boxes])]
        only_boxes_allowed = set(config.cameras)
        notes += [] if config.cameras else ["topics.cameras is empty: no camera is used"]
    else:
        recorded = readable(topics_with_messages(recording, IMAGE, config), "camera", findings)
        frames |= {info.topic: first.frame(info.topic, IMAGE) for info in recorded}
        infos = [
            info
            for info in recorded
            if info.topic in of_rig
            or frames[info.topic] not in lidar_frames
            or _best(info.topic, calibrations, frames, single=len(recorded) == 1)
        ]
        notes += [
            f"{info.topic}: without CameraInfo, in {frames[info.topic]}, the frame of a lidar, not used"
            for info in recorded
            if info not in infos
        ]
        images = _one_per_camera(
            first_hand(infos, notes, lambda info: (1, MADE) if info.part_of else (0, "")), first, notes
        )
        places = {place(topic) for topic in calibrations}
        sources = image_sources(recording, images, first, limits, has_info=lambda topic: place(topic) in places)
        images = sensors_of(sources, "cameras", notes, of_rig, was_choice=infos != recorded)
        only_boxes_allowed = set(boxes)

    frames |= {topic: first.frame(topic, IMAGE) for topic in images}
    frames |= {topic: first.frame(topic, BOXES) for topic in boxes}
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
    if first.missing(info.topic, IMAGE):
        return False
    content = first.decoded(info.topic, IMAGE)
    encoding = getattr(content, "encoding", "") or getattr(content, "format", "")
    return not DEPTH_ENCODINGS.isdisjoint(encoding.split(";"))  # `16UC1; png compressed`; FFMPEGPacket: `hevc;16UC1`


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
