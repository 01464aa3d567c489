"""The sensors of a recording, before they are calibrated: their topics, their frames, and the site frame."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.errors import CalibrationError, FrameError, RecordingError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import Zone
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import listed
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame, read_transforms
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar, assign_cameras, assign_lidars
from lidcam.readers.rig.calibration import rigid_transform
from lidcam.readers.rig.detectors import BOXES_3D, boxes_frame, find_detector_topics, usable_boxes
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.schema import Edges, RigFile
from lidcam.readers.rig.sensor_topics import CAMERA_INFO, CLOUD, OPTICAL, Findings, topics_with_messages
from lidcam.readers.rig.topic_names import place
from lidcam.readers.rig.topics.cameras import find_camera_topics
from lidcam.readers.rig.topics.lidars import find_lidar_topics
from lidcam.readers.rig.undecoded import undecoded

BEYOND_SITE = frozenset({"earth", "utm"})
"""Frames with coordinates of millions of metres, in which float32 points would lose their centimetres."""

CLOUD_TYPES = "sensor_msgs/PointCloud2, plain or compressed, packets of a Velodyne or an Ouster, or Livox's CustomMsg"
"""The types of `CLOUD` as users call them."""

MAX_LISTED = 10
"""Largest number of topics that an error lists."""


class FoundSensors(NamedTuple):
    """The sensors of a recording and what is known of them."""

    recording: Recording  # The open recording
    rig_file: RigFile  # The rig file; empty without one
    first: FirstMessages  # First messages of the recording
    transforms: RecordedTransforms  # Transforms of the rig file and the recording
    of_rig: frozenset[str]  # Child frames whose transform the rig file gives
    lidars: Sequence[AssignedLidar]  # Lidars in the order of processing; so are the cameras
    cameras: Sequence[AssignedCamera]
    detectors: Sequence[str]  # Topics of recorded 3D boxes
    config: Config
    # Frame by name of a lidar whose messages can be decoded; empty if neither they nor the rig name one
    named: Mapping[str, str]
    frames: Mapping[str, str]  # Frame by name of a lidar, found by its name in tf where it has none
    site: str  # The site frame
    is_site_named: bool  # Whether the settings or the rig name the site frame
    zones: tuple[Zone, ...]
    findings: tuple[Findings, Findings, Findings]  # Faults and notes of lidars, of 3D boxes, of cameras


def find_sensors(
    recording: Recording, config: Config, rig_file: RigFile | None, *, start_ns: int | None, stop_ns: int | None
) -> FoundSensors:
    """The sensors of a recording.

    The site frame is the configured one, else the rig file's, else `base_link` if lidars are fixed to it, else the end
    of the chain of fixed transforms that most lidars and cameras (the first of equals) hang on. A camera's optical
    frame cannot be the site frame (z is not up); then it is the lidar's own. A lidar whose messages name no frame has
    the one that tf knows by its name or a part of its topic, else one of its own; several such lidars need poses.

    tf_static and the beginning of the other topics are read, tf also from `start_ns` on and to before `stop_ns` (log
    times). What the rig file lacks is taken from CameraInfo and tf.

    Raises:
        CalibrationError: the rig file says that there is no lidar, or a transform of it is not valid.
        RecordingError: the recording has no clouds, nor boxes of a 3D detector that are to be used; or cannot be read.
    """
    rig_file = rig_file or RigFile()
    first = FirstMessages(recording, config.velodyne, limits=config.limits)
    recorded = read_transforms(recording, start_ns=start_ns, stop_ns=stop_ns, limits=config.limits)
    transforms, of_rig = _with_rig(recorded, rig_file)
    of_lidars, of_cameras, of_detectors = Findings(), Findings(), Findings()
    detectors = find_detector_topics(recording, config, first, of_detectors)
    lidar_entries, camera_entries = (rig_file.lidars or {}).values(), (rig_file.cameras or {}).values()
    named_topics = {entry.topic for entry in (*lidar_entries, *camera_entries)}
    named_topics |= {entry.boxes_topic for entry in camera_entries}
    lidar_topics = find_lidar_topics(recording, config.topics, first, of_lidars, transforms, of_rig=named_topics)
    lidars = assign_lidars(rig_file.lidars, lidar_topics, recording, of_lidars)
    if not lidars and not detectors:
        if rig_file.lidars == {}:
            raise CalibrationError(
                "the rig file says `lidars: {}`, no lidar: name one, or leave `lidars` out to use all"
            )
        if config.topics.lidars == ():
            raise CalibrationError(
                "the settings say `topics.lidars: []`, no lidar: name one, or leave it out to use all"
            )
        if not of_lidars.faults:
            raise RecordingError(_no_clouds(recording, config, of_lidars, of_detectors))
    camera_topics = find_camera_topics(
        recording,
        config.topics,
        first,
        of_cameras,
        limits=config.limits,
        lidar_frames={first.frame(lidar.topic, CLOUD) for lidar in lidars} - {""},
        of_rig=named_topics,
    )
    taken = {lidar.name for lidar in lidars} | {"lidar", "fused"}
    cameras = assign_cameras(rig_file.cameras, camera_topics, recording, of_cameras, taken=taken)

    named = {
        lidar.name: clean_frame(lidar.entry.frame_id) or first.frame(lidar.topic, CLOUD)
        for lidar in lidars
        if not first.missing(lidar.topic, CLOUD)
    }
    frames = _lidar_frames(lidars, named, transforms)
    camera_frames = {first.frame(camera.topics.info, CAMERA_INFO) for camera in cameras if camera.topics.info}
    transforms.join_by_means([*frames.values(), *camera_frames])
    wanted = clean_frame(config.rig.site_frame or rig_file.site_frame)
    if wanted:
        site = wanted
    elif detectors and not frames:
        site = _site_of_boxes([boxes_frame(topic, first) for topic in detectors], camera_frames, transforms)
    else:
        usable = [frames[name] for name in named]  # lidars whose messages can be decoded
        site = _site_frame(usable or list(frames.values()), camera_frames, transforms)
    return FoundSensors(
        recording=recording,
        rig_file=rig_file,
        first=first,
        transforms=transforms,
        of_rig=of_rig,
        lidars=lidars,
        cameras=cameras,
        detectors=detectors,
        config=config,
        named=named,
        frames=frames,
        site=site,
        is_site_named=bool(wanted),
        zones=zones_of(rig_file, config),
        findings=(of_lidars, of_detectors, of_cameras),
    )


def zones_of(rig_file: RigFile | None, config: Config) -> tuple[Zone, ...]:
    """The zones of the rig file, else those of the settings."""
    given = config.rig.zones if rig_file is None or rig_file.zones is None else rig_file.zones
    return tuple(Zone(name, np.array(zone.corners, np.float64), zone.use) for name, zone in given.items())


def _with_rig(recorded: RecordedTransforms, rig_file: RigFile) -> tuple[RecordedTransforms, frozenset[str]]:
    """The recorded transforms, in whose place those of the rig file stand, and the child frames of the latter."""
    tree, moving = recorded.fixed, recorded.moving
    given = _transforms(rig_file.transforms)
    for transform in given:
        tree.add_static(transform)
    for transform in _transforms(rig_file.default_transforms):
        if tree.parent(transform.src) is None and transform.src not in moving:
            tree.add_static(transform)
            given.append(transform)
    children = frozenset(transform.src for transform in given)
    transforms = replace(
        recorded,
        moving={child: parent for child, parent in moving.items() if child not in children},
        swaying={child: sway for child, sway in recorded.swaying.items() if child not in children},
        faults={child: fault for child, fault in recorded.faults.items() if child not in children},
    )
    return transforms, children


def _transforms(edges: Edges) -> list[Transform]:
    """T_parent_child of each edge; without translation and rotation the identity."""
    found = []
    for parent, row in edges.items():
        for child, pose in row.items():
            try:
                matrix = pose.matrix()
            except CalibrationError as err:
                raise CalibrationError(f"transforms: {child}: {err}") from err
            found.append(rigid_transform(f"the pose of {child}", clean_frame(parent), clean_frame(child), matrix))
    return found


def _lidar_frames(
    lidars: Sequence[AssignedLidar], named: Mapping[str, str], transforms: RecordedTransforms
) -> dict[str, str]:
    """Frame by lidar: as named, else one in tf with the lidar's name or a part of its topic, else its name."""
    frames = {lidar.name: named.get(lidar.name, "") for lidar in lidars}
    known = transforms.fixed.frames - set(frames.values())
    for lidar in lidars:
        if not frames[lidar.name]:
            words = (lidar.name, *place(lidar.topic))
            frames[lidar.name] = next((word for word in words if word in known), lidar.name)
            known -= {frames[lidar.name]}
    return frames


def _site_frame(lidar_frames: Sequence[str], camera_frames: set[str], transforms: RecordedTransforms) -> str:
    ends: list[tuple[str, str]] = []
    for frame in lidar_frames:
        try:
            chain = transforms.fixed.chain(frame)
        except FrameError:  # a circle: the lidar itself is reported when its pose is looked up
            continue
        chain = chain[: next((i for i, name in enumerate(chain) if name in BEYOND_SITE and i), len(chain))]
        ends.append((frame, "base_link" if transforms.are_joined("base_link", frame) else chain[-1]))
    if not ends:
        return lidar_frames[0] if lidar_frames else ""
    roots = [root for _, root in ends]
    cameras = {one: sum(transforms.are_joined(one, frame) for frame in camera_frames) for one in {*roots}}
    root = max(roots, key=lambda one: roots.count(one) + cameras[one])  # the first of equals
    if (root in camera_frames and root != "base_link") or root.endswith(OPTICAL):
        return next(frame for frame, end in ends if end == root)
    return root


def _site_of_boxes(boxes_frames: Sequence[str], camera_frames: set[str], transforms: RecordedTransforms) -> str:
    """The site frame of a recording without lidars: the vehicle, if there is one, else where the boxes are."""
    if "base_link" in transforms.fixed.frames or "base_link" in transforms.moving:
        return "base_link"
    return _site_frame([frame for frame in boxes_frames if frame], camera_frames, transforms) or "site"


def _no_clouds(recording: Recording, config: Config, of_lidars: Findings, of_detectors: Findings) -> str:
    apart = f", apart from {', '.join(config.topics.exclude)}" if config.topics.exclude else ""
    expected = (
        f"{', '.join(str(path) for path in recording.paths)}: expected a topic of lidar clouds ({CLOUD_TYPES}){apart}"
    )
    if config.detect3d.method == "recorded":
        because = "".join(f"; {fault.topic}: {fault.reason}" for fault in of_detectors.faults[:MAX_LISTED])
        return (
            f"{expected}, or of 3D boxes ({' or '.join(sorted(BOXES_3D))}) that are neither truth nor lidcam's own, "
            f"found neither{because}; name one with topics.boxes3d"
        )
    if boxes := usable_boxes(recording, config.topics):
        return (
            f"{expected}; found 3D boxes: {_listed(boxes)}; --set detect3d.method=recorded goes by the boxes of "
            "a detector"
        )
    if lines := undecoded(recording, recording.topics):
        return f"{expected}; found {'; '.join(lines[:MAX_LISTED])}"
    if clouds := [info.topic for info in topics_with_messages(recording, CLOUD, config.topics)][:MAX_LISTED]:
        reasons = "; ".join(note for note in of_lidars.notes if note.partition(": ")[0] in clouds)
        return f"{expected}; found {reasons}; to use them: --set 'topics.lidars=[{','.join(clouds)}]'"
    there = any(info.msgtype in CLOUD for info in recording.topics)
    remedy = "see topics.exclude of the settings" if there else "record the clouds of the driver, too"
    return f"{expected}; found topics: {_listed(recording.topics) or 'none'}; {remedy}"


def _listed(topics: Sequence[TopicInfo]) -> str:
    return listed([f"{info.topic} ({info.msgtype}, {info.message_count})" for info in topics])
