"""The rig of a recording: the sensors whose calibration is valid, and why the others are left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.core.errors import CalibrationError, FrameError, LidcamError, RecordingError
from pipeline.core.rig import CameraSensor, LidarSensor, Rig, Zone
from pipeline.core.settings.config import Config
from readers.messages.tf import RecordedTransforms, clean_frame, read_transforms
from readers.recording import Recording, TopicInfo
from readers.rig.assignment import AssignedLidar, assign_cameras, assign_lidars
from readers.rig.calibration import OWN_SITE, SensorSource, calibrate_camera, calibrate_lidar
from readers.rig.first_messages import FirstMessages
from readers.rig.schema import RigFile
from readers.rig.sensor_topics import CAMERA_INFO, CLOUD, Findings, SensorFault, find_camera_topics, find_lidar_topics
from readers.rig.topic_names import place

__all__ = ["Discovery", "discover_rig", "zones_of"]

BEYOND_SITE = frozenset({"earth", "utm"})
"""Frames with coordinates of millions of metres, in which float32 points would lose their centimetres."""


RAW_LIDAR = frozenset(
    {
        "livox_ros_driver/msg/CustomMsg",
        "livox_ros_driver2/msg/CustomMsg",
        "nebula_msgs/msg/NebulaPackets",
        "ouster_ros/msg/PacketMsg",
        "ouster_sensor_msgs/msg/PacketMsg",
        "pandar_msgs/msg/PandarScan",
        "rslidar_msg/msg/RslidarPacket",
    }
)
"""Types of what a lidar sends, which only its driver can turn into clouds."""

MAX_LISTED = 10
"""Topics that an error lists at most."""


@dataclass(frozen=True, slots=True)
class Discovery:
    """A rig and where it was found.

    Attributes:
        rig: Sensors with a valid calibration.
        faults: Sensors that are left out.
        sources: One per sensor of the rig, lidars first.
        notes: Topics that are not used, and topics that were assigned by order.
        transforms: Transforms of the recording.
    """

    rig: Rig
    faults: tuple[SensorFault, ...]
    sources: tuple[SensorSource, ...]
    notes: tuple[str, ...]
    transforms: RecordedTransforms = field(repr=False)


def discover_rig(
    recording: Recording,
    config: Config,
    rig_file: RigFile | None = None,
    *,
    start_ns: int | None = None,
    stop_ns: int | None = None,
) -> Discovery:
    """The rig of a recording.

    The site frame is the configured one, else the rig file's, else `base_link` if lidars are fixed to it, else the end
    of the chain of fixed transforms that most lidars (the first of equals) hang on. A camera's optical frame cannot be
    the site frame (z is not up); then it is the lidar's own. A lidar whose messages name no frame has the one that tf
    knows by its name or a part of its topic, else one of its own; several such lidars need poses.

    Args:
        recording: Open recording; tf_static and the beginning of the other topics are read.
        config: Settings: which topics are used, and the site frame.
        rig_file: What is known; the rest is taken from CameraInfo and tf.
        start_ns: Begin of the part that is processed, by log time: tf is read there, too. None is the recording's.
        stop_ns: Its end (exclusive).

    Raises:
        CalibrationError: no lidar is usable, with the reason for each; or the poses of several lidars are unknown.
        RecordingError: the recording has no clouds, or cannot be read.
    """
    rig_file = rig_file or RigFile()
    first = FirstMessages(recording, config.velodyne)
    transforms = read_transforms(recording, start_ns=start_ns, stop_ns=stop_ns)
    of_lidars, of_cameras = Findings(), Findings()
    lidar_topics = find_lidar_topics(recording, config.topics, first, of_lidars)
    lidars = assign_lidars(rig_file.lidars, lidar_topics, recording, of_lidars)
    if not lidars and rig_file.lidars == {}:
        raise CalibrationError("the rig file says `lidars: {}`, no lidar: name one, or leave `lidars` out to use all")
    if not lidars and not of_lidars.faults:
        raise RecordingError(_no_clouds(recording, config))
    camera_topics = find_camera_topics(recording, config.topics, first, of_cameras)
    taken = {lidar.name for lidar in lidars} | {"lidar", "fused"}
    cameras = assign_cameras(rig_file.cameras, camera_topics, recording, of_cameras, taken=taken)

    named = {
        lidar.name: clean_frame(lidar.entry.frame_id) or first.frame(lidar.topic, CLOUD)
        for lidar in lidars
        if not first.missing(lidar.topic, CLOUD)
    }
    frames = _lidar_frames(lidars, named, transforms)
    camera_frames = {first.frame(camera.topics.info, CAMERA_INFO) for camera in cameras if camera.topics.info}
    wanted = clean_frame(config.rig.site_frame or rig_file.site_frame)
    site = wanted or _site_frame(list(frames.values()), camera_frames, transforms)

    sources: list[SensorSource] = []
    lidar_sensors: list[LidarSensor] = []
    for lidar in lidars:
        try:
            sensor, source = calibrate_lidar(lidar, frames[lidar.name], site, first, transforms)
        except LidcamError as err:
            of_lidars.leave_out(lidar.name, lidar.topic, err)
        else:
            lidar_sensors.append(sensor)
            sources.append(source)
    if not lidar_sensors:
        raise CalibrationError(_no_lidar(of_lidars.faults, site))
    used = [source.topic for source in sources]
    apart = [lidar.topic for lidar in lidars if named.get(lidar.name) == "" and lidar.topic not in used]
    if apart and all(source.extrinsics == OWN_SITE for source in sources):
        raise CalibrationError(_no_poses(recording, used + apart))

    camera_sensors: list[CameraSensor] = []
    for camera in cameras:
        try:
            camera_sensor, source = calibrate_camera(camera, site, first, transforms)
        except LidcamError as err:
            of_cameras.leave_out(camera.name, camera.topics.topic, err)
        else:
            camera_sensors.append(camera_sensor)
            sources.append(source)
    rig = Rig(site, tuple(lidar_sensors), tuple(camera_sensors), zones_of(rig_file, config), rig_file.ground_height_m)
    faults, notes = of_lidars.faults + of_cameras.faults, of_lidars.notes + of_cameras.notes
    return Discovery(rig, tuple(faults), tuple(sources), tuple(notes), transforms)


def zones_of(rig_file: RigFile | None, config: Config) -> tuple[Zone, ...]:
    """The zones of the rig file, else those of the settings."""
    given = config.rig.zones if rig_file is None or rig_file.zones is None else rig_file.zones
    return tuple(Zone(name, np.array(corners, np.float64)) for name, corners in given.items())


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
    root = max(roots, key=roots.count)  # the first of equals
    if root in camera_frames or root.endswith(("optical", "optical_frame")):
        return next(frame for frame, end in ends if end == root)
    return root


def _no_clouds(recording: Recording, config: Config) -> str:
    apart = f", apart from {', '.join(config.topics.exclude)}" if config.topics.exclude else ""
    expected = (
        f"{', '.join(str(path) for path in recording.paths)}: expected a topic of lidar clouds "
        f"({' or '.join(sorted(CLOUD))}){apart}"
    )
    if raw := [info for info in recording.topics if info.msgtype in RAW_LIDAR]:
        return (
            f"{expected}; found {_listed(raw)}, which lidcam does not read yet: play the recording through the lidar's "
            "driver and record the clouds that it publishes"
        )
    there = any(info.msgtype in CLOUD for info in recording.topics)
    remedy = "see topics.exclude and topics.lidars of the settings" if there else "record the clouds of the driver, too"
    return f"{expected}; found topics: {_listed(recording.topics) or 'none'}; {remedy}"


def _listed(topics: Sequence[TopicInfo]) -> str:
    more = f" and {len(topics) - MAX_LISTED} more" if len(topics) > MAX_LISTED else ""
    return ", ".join(f"{info.topic} ({info.msgtype}, {info.message_count})" for info in topics[:MAX_LISTED]) + more


def _no_poses(recording: Recording, topics: Sequence[str]) -> str:
    return (
        f"{', '.join(str(path) for path in recording.paths)}: found {len(topics)} lidars ({', '.join(topics)}) "
        "without poses: give their poses in a rig file (--rig), or take one of them "
        f"(--set topics.lidars=[{topics[0]}])"
    )


def _no_lidar(faults: Sequence[SensorFault], site: str) -> str:
    reasons = "; ".join(f"{fault.sensor} ({fault.topic}): {fault.reason}" for fault in faults)
    return (
        f"no lidar is usable in site frame {site!r}: {reasons}; give the lidars' poses in a rig file (--rig), "
        "or another site frame (--set rig.site_frame=FRAME)"
    )
