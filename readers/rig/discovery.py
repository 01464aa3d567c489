"""The rig of a recording: the sensors whose calibration is valid, and why the others are left out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from lidcam.pipeline.core.errors import CalibrationError, LidcamError
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.recording import Recording
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar
from lidcam.readers.rig.calibration import OWN_SITE, Frames, SensorSource, calibrate_camera, calibrate_lidar
from lidcam.readers.rig.detectors import calibrated_detectors
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.search import FoundSensors, find_sensors
from lidcam.readers.rig.sensor_topics import Findings, SensorFault

Assigned = AssignedLidar | AssignedCamera

MAX_LISTED = 10
"""Cameras that an error lists at most."""


@dataclass(frozen=True, slots=True)
class Discovery:
    """A rig and where it was found.

    Attributes:
        rig: Sensors with a valid calibration.
        faults: Sensors that are left out.
        sources: One per sensor of the rig: lidars, recorded 3D detectors, cameras.
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
        rig_file: Known calibration; the rest is taken from CameraInfo and tf.
        start_ns: Begin of the part that is processed, by log time: tf is read there, too. None is the recording's.
        stop_ns: Its end (exclusive).

    Raises:
        CalibrationError: no lidar is usable, nor a detector's boxes, with the reason for each; or the poses of several
            lidars are unknown.
        RecordingError: the recording has no clouds, or cannot be read.
    """
    return calibrated_rig(find_sensors(recording, config, rig_file, start_ns=start_ns, stop_ns=stop_ns))


def calibrated_rig(found: FoundSensors) -> Discovery:
    """The rig of the sensors that were found.

    Raises:
        CalibrationError: no lidar is usable, nor a detector's boxes, with the reason for each; or the poses of several
            lidars are unknown.
    """
    _check_site_is_named(found)
    of_lidars = Findings([*found.of_lidars.faults], [*found.of_lidars.notes])
    of_cameras = Findings([*found.of_cameras.faults], [*found.of_cameras.notes])
    frames, sources = Frames(found.site, found.transforms, found.of_rig), dict[str, SensorSource]()
    lidar_sensors: dict[str, LidarSensor] = {}
    camera_sensors: dict[str, CameraSensor] = {}
    for sensor in parents_first((*found.lidars, *found.cameras)):
        try:
            if isinstance(sensor, AssignedLidar):
                lidar, source = calibrate_lidar(sensor, found.frames[sensor.name], frames, found.first)
                lidar_sensors[sensor.name] = lidar
                frames.sensors[sensor.name] = lidar.T_site_lidar
            else:
                camera, source = calibrate_camera(sensor, frames, found.first)
                camera_sensors[sensor.name] = camera
                frames.sensors[sensor.name] = camera.T_camera_site.inverse()
        except LidcamError as err:
            if isinstance(sensor, AssignedLidar):
                of_lidars.leave_out(sensor.name, sensor.topic, err)
            else:
                of_cameras.leave_out(sensor.name, sensor.topics.topic, err)
        else:
            sources[sensor.name] = source
    if not lidar_sensors and not found.detectors:
        raise CalibrationError(_no_lidar(of_lidars.faults, found.site))
    used = [lidar.topic for lidar in lidar_sensors.values()]
    apart = [lidar.topic for lidar in found.lidars if found.named.get(lidar.name) == "" and lidar.topic not in used]
    if apart and all(sources[name].extrinsics == OWN_SITE for name in lidar_sensors):
        topics = used + apart
        raise CalibrationError(
            f"{', '.join(str(path) for path in found.recording.paths)}: found {len(topics)} lidars "
            f"({', '.join(topics)}) without poses: give their poses in a rig file (--rig), or take one of them "
            f"(--set topics.lidars=[{topics[0]}])"
        )
    rig = Rig(
        found.site,
        tuple(lidar_sensors[lidar.name] for lidar in found.lidars if lidar.name in lidar_sensors),
        tuple(camera_sensors[camera.name] for camera in found.cameras if camera.name in camera_sensors),
        found.zones,
        found.rig_file.ground_height_m,
        found.rig_file.vehicles,
    )
    of_boxes = Findings([*found.of_detectors.faults], [*found.of_detectors.notes])
    detectors, of_detectors = calibrated_detectors(
        found.detectors, rig, found.recording, found.transforms, found.config, found.first, of_boxes
    )
    rig = replace(rig, detectors=detectors)
    if not rig.lidars and not rig.detectors:
        raise CalibrationError(_no_lidar([*of_lidars.faults, *of_boxes.faults], found.site))
    found_ones = of_lidars, of_boxes, of_cameras
    return Discovery(
        rig,
        tuple(fault for findings in found_ones for fault in findings.faults),
        (
            *(sources[lidar.name] for lidar in rig.lidars),
            *of_detectors,
            *(sources[camera.name] for camera in rig.cameras),
        ),
        tuple(note for findings in found_ones for note in findings.notes),
        found.transforms,
    )


def parents_first(sensors: Sequence[Assigned]) -> list[Assigned]:
    """Sensors in an order in which those that a pose refers to come before it; those of a circle come last."""
    waiting, ordered = [*sensors], list[Assigned]()
    while waiting:
        names = {sensor.name for sensor in waiting}
        ready = [sensor for sensor in waiting if sensor.entry.parent not in names] or waiting
        ordered += ready
        waiting = [sensor for sensor in waiting if sensor not in ready]
    return ordered


def _check_site_is_named(found: FoundSensors) -> None:
    """Refuse poses of the rig file in a frame without a name.

    Without it, the poses of other sensors in that frame are unknown, and any site frame would move them against it.
    """
    if found.is_site_named or not found.lidars:  # without a lidar there is a worse fault to report
        return
    lidars = [lidar.name for lidar in found.lidars if lidar.entry.has_pose and not lidar.entry.parent]
    cameras = [camera.name for camera in found.cameras if camera.entry.has_pose and not camera.entry.parent]
    if lidars:
        raise CalibrationError(
            f"site_frame is missing in the rig file: name the frame that the pose of {', '.join(lidars)} is given in"
        )
    if cameras:
        raise CalibrationError(_no_site_frame(found, cameras))


def _no_lidar(faults: Sequence[SensorFault], site: str) -> str:
    reasons = "; ".join(f"{fault.sensor} ({fault.topic}): {fault.reason}" for fault in faults)
    if not site:  # none of them was recorded, so poses would not help
        return f"no lidar is usable in this recording: {reasons}; correct topics.lidars, or the lidars of the rig file"
    return (
        f"no lidar is usable in site frame {site!r}: {reasons}; give the lidars' poses in a rig file (--rig), "
        "or another site frame (--set rig.site_frame=FRAME)"
    )


def _no_site_frame(found: FoundSensors, cameras: Sequence[str]) -> str:
    lidars, site = [lidar.name for lidar in found.lidars], found.site
    more = f" and {len(cameras) - MAX_LISTED} more" if len(cameras) > MAX_LISTED else ""
    known = all(frame == site or found.transforms.are_joined(site, frame) for frame in found.frames.values())
    or_else = f"; or, if that frame is {site!r} of the recording, --set rig.site_frame={site}" if known else ""
    return (
        f"the rig file gives the pose of {', '.join(cameras[:MAX_LISTED])}{more} in a frame that it does not name, so "
        f"where the lidars ({', '.join(lidars)}) are in it is unknown: give a second --rig with `site_frame: NAME` and "
        f"`lidars: {{{lidars[0]}: {{translation_m: [x, y, z], rpy_deg: [r, p, y]}}, ...}}`{or_else}"
    )
