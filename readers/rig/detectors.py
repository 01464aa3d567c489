"""Topics of the boxes of 3D detectors, and the frames in which their boxes may be."""

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import count

from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import TopicsConfig
from lidcam.pipeline.evaluation.evaluation_frame import SOURCES
from lidcam.readers.messages.detections import DETECTIONS_3D
from lidcam.readers.messages.registry import types_of
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.calibration import OWN_SITE, SensorSource
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import Findings, configured_topics, topics_with_messages
from lidcam.readers.rig.topic_names import is_truth
from lidcam.readers.streams.motion import find_motion_source

BOXES_3D = types_of("3D boxes")

OWN_BOXES = frozenset(f"/{source}/detections" for source in SOURCES)
"""Topics of 3D boxes that lidcam itself writes: used only where the settings name them."""


def find_detector_topics(recording: Recording, config: Config, first: FirstMessages, findings: Findings) -> list[str]:
    """Topics of recorded 3D boxes, in natural order or as configured; none unless `detect3d.method` is `recorded`.

    Truth is none of them, nor is what lidcam itself wrote, unless the settings name it.
    """
    infos = usable_boxes(recording, config.topics)
    if config.detect3d.method != "recorded":
        findings.notes.extend(
            f"{info.topic}: 3D boxes, not used; --set detect3d.method=recorded takes them instead of what lidcam finds"
            for info in infos
        )
        return []
    if config.topics.boxes3d is not None:
        chosen = configured_topics(recording, config.topics.boxes3d, BOXES_3D, "3D boxes", findings)
    else:
        chosen = [info.topic for info in infos]
    usable = []
    for topic in chosen:
        if first.missing(topic, BOXES_3D):
            findings.leave_out("3D boxes", topic, "none of its first messages can be decoded")
        else:
            usable.append(topic)
    return usable


def usable_boxes(recording: Recording, config: TopicsConfig) -> list[TopicInfo]:
    """Topics of 3D boxes that can be read and are neither truth, nor excluded, nor lidcam's own, in natural order."""
    return [
        info
        for info in topics_with_messages(recording, BOXES_3D, config)
        if not (info.unreadable or info.topic in OWN_BOXES or is_truth(info.topic, DETECTIONS_3D))
    ]


def boxes_frame(topic: str, first: FirstMessages) -> str:
    """The frame of a topic's boxes by its first message, or the first box in it; empty if neither names one."""
    message = first.decoded(topic, BOXES_3D)
    first_box = next(iter(getattr(message, "detections", ())), None)
    own = getattr(getattr(first_box, "header", None), "frame_id", "")  # not every layout has it
    return clean_frame(message.header.frame_id) or clean_frame(own if isinstance(own, str) else "")


def calibrated_detectors(
    topics: Sequence[str],
    rig: Rig,
    recording: Recording,
    transforms: RecordedTransforms,
    config: Config,
    first: FirstMessages,
    findings: Findings,
) -> tuple[tuple[RecordedDetector, ...], tuple[SensorSource, ...]]:
    """Detectors with the frames in which their boxes may be, and the source of each.

    Boxes may be in any frame that is fixed to the site frame, the sensors' among them, or to the frame in which the
    site frame is known to move (`map`, `odom`). `findings` gets the detectors whose boxes are in another frame.
    """
    site = rig.site_frame
    of_site = _joined(site, transforms)
    of_site |= {camera.T_camera_site.dst: camera.T_camera_site.inverse() for camera in rig.cameras}
    of_site |= {lidar.T_site_lidar.src: lidar.T_site_lidar for lidar in rig.lidars}
    of_site |= {site: Transform.identity(site, site)}
    frames = {topic: boxes_frame(topic, first) for topic in topics}
    of_fixed: Mapping[str, Transform] = {}
    if any(frame and frame not in of_site for frame in frames.values()):
        motion = find_motion_source(recording, rig, transforms, config)
        of_fixed = _joined(motion.fixed_frame_id, transforms) if motion else {}
    detectors, sources = list[RecordedDetector](), list[SensorSource]()
    taken = {*rig.sensor_of_topic.values()}
    for topic, frame in frames.items():
        name = _name(topic, taken)
        if not frame:
            findings.notes.append(f"{topic}: its messages name no frame, taken to be the site frame {site!r}")
        elif frame not in of_site and frame not in of_fixed:
            findings.leave_out(
                name,
                topic,
                f"its boxes are in frame {frame!r}, which nothing joins with the site frame {site!r}: no fixed "
                f"transforms, and {site!r} is not known to move in it; give its pose in a rig file (transforms: "
                f"{{{site}: {{{frame}: {{translation_m: [x, y, z], rpy_deg: [r, p, y]}}}}}})",
            )
            continue
        taken.add(name)
        detectors.append(RecordedDetector(name, topic, frame or site, of_site, of_fixed))
        sources.append(SensorSource(name, topic, frame or site, "", _source(frame or site, site, of_site)))
    return tuple(detectors), tuple(sources)


def _joined(frame: str, transforms: RecordedTransforms) -> dict[str, Transform]:
    """T_frame_other of all frames that fixed transforms join with a frame, itself included; each edge is used once."""
    tree = transforms.fixed
    known = {frame: Transform.identity(frame, frame)}
    child = frame
    while (edge := tree.edge(child)) is not None and edge.dst not in known:  # known: they run in a circle
        known[edge.dst] = known[child] @ edge.inverse()
        child = edge.dst
    for one in sorted(tree.frames):
        way, last = dict[str, Transform](), one
        while last not in known and last not in way and (edge := tree.edge(last)) is not None:
            way[last] = edge
            last = edge.dst
        for edge in reversed(way.values()) if last in known else ():  # else another tree, or a circle
            known[edge.src] = known[edge.dst] @ edge
    return known


def _source(frame: str, site: str, of_site: Collection[str]) -> str:
    if frame == site:
        return OWN_SITE
    return f"{site} <- {frame}" if frame in of_site else f"motion of {site} in {frame}"


def _name(topic: str, taken: Collection[str]) -> str:
    name = re.sub(r"\W", "_", topic.strip("/"), flags=re.ASCII) or "boxes"
    names = (name if number == 1 else f"{name}_{number}" for number in count(1))
    return next(one for one in names if one not in taken)
