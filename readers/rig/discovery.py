"""The rig of a recording: the sensors whose calibration is valid, and why the others are left out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lidcam.pipeline.core.errors import CalibrationError, LidcamError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.text import listed
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.recording import Recording
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar
from lidcam.readers.rig.calibration import (
    OWN_SITE,
    Frames,
    SensorSource,
    calibrate_camera,
    calibrate_lidar,
    camera_frame,
)
from lidcam.readers.rig.clocks import clock_note, clock_offsets, stamped_delay_ns, usual_delay_ns
from lidcam.readers.rig.detectors import calibrated_detectors
from lidcam.readers.rig.schema import RigFile
from lidcam.readers.rig.search import FoundSensors, find_sensors
from lidcam.readers.rig.sensor_topics import BOXES, CLOUD, IMAGE, Findings, SensorFault

Assigned = AssignedLidar | AssignedCamera


@dataclass(frozen=True, slots=True)
class Discovery:
    """A rig and where it was found."""

    rig: Rig  # Sensors with a valid calibration
    faults: tuple[SensorFault, ...]  # Sensors that are left out
    sources: tuple[SensorSource, ...]  # One per sensor of the rig: lidars, recorded 3D detectors, cameras
    notes: tuple[str, ...]  # Topics that are not used, and topics that were assigned by order
    transforms: RecordedTransforms = field(repr=False)  # Transforms of the recording
    usual_delay_ns: int = 0  # Usual log time minus stamp


def discover_rig(
    recording: Recording,
    config: Config,
    rig_file: RigFile | None = None,
    *,
    start_ns: int | None = None,
    stop_ns: int | None = None,
) -> Discovery:
    """The rig of a recording; arguments and errors as of `find_sensors` and `calibrated_rig`."""
    return calibrated_rig(find_sensors(recording, config, rig_file, start_ns=start_ns, stop_ns=stop_ns))


def calibrated_rig(found: FoundSensors) -> Discovery:
    """The rig of the sensors of a recording.

    Raises:
        CalibrationError: no lidar is usable, nor a detector's boxes, with the reason for each; or the poses of several
            lidars are unknown.
    """
    _check_site_is_named(found)
    of_lidars, of_boxes, of_cameras = findings = tuple(map(Findings.copy, found.findings))
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
                camera, source, remark = calibrate_camera(sensor, frames, found.first)
                of_cameras.notes.extend([f"{sensor.name}: {remark}"] if remark else [])
                camera_sensors[sensor.name] = camera
                frames.sensors[sensor.name] = camera.T_camera_site.inverse()
        except LidcamError as err:
            (of_lidars if isinstance(sensor, AssignedLidar) else of_cameras).leave_out(sensor.name, sensor.topic, err)
        else:
            sources[sensor.name] = source
    if not lidar_sensors and not found.detectors:
        raise CalibrationError(_no_lidar(of_lidars.faults, found.site, can_decode=bool(found.named)))
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
    detectors, of_detectors = calibrated_detectors(
        found.detectors, rig, found.recording, found.transforms, found.config, found.first, of_boxes
    )
    rig = replace(rig, detectors=detectors)
    if not rig.lidars and not rig.detectors:
        raise CalibrationError(_no_lidar([*of_lidars.faults, *of_boxes.faults], found.site))
    rig, usual_ns, of_clocks = _with_clocks_set(rig, found)
    rig = _with_own_frames(rig, of_cameras.notes)
    offsets_ns = {lidar.name: lidar.time_offset_ns for lidar in rig.lidars}
    offsets_ns |= {camera.name: camera.time_offset_ns for camera in rig.cameras}
    sources = {name: replace(one, time_offset_ms=offsets_ns[name] / 1e6) for name, one in sources.items()}
    return Discovery(
        rig,
        tuple(fault for one in findings for fault in one.faults),
        (
            *(sources[lidar.name] for lidar in rig.lidars),
            *of_detectors,
            *(sources[camera.name] for camera in rig.cameras),
        ),
        (*(note for one in findings for note in one.notes), *_notes_of_tf(found, frames), *of_clocks),
        found.transforms,
        usual_ns,
    )


def _notes_of_tf(found: FoundSensors, frames: Frames) -> list[str]:
    notes = []
    if changed := sorted(found.transforms.changed - found.of_rig):
        notes.append(
            f"tf gives several poses of {listed(changed)}: the last one of tf_static is used for "
            "the whole recording; if it is another one, give it in a rig file (transforms)"
        )
    known, site = found.transforms.fixed.frames, found.site
    if not found.is_site_named and site in found.frames.values() and site not in {*known, *found.transforms.moving}:
        told = f"tf has no such frame, but {listed(sorted(known))}" if known else ""
        if reason := found.transforms.faults.get(site, told):
            notes.append(f"poses are in {site}, the lidar's own frame: {reason}; see transforms in a rig file (--rig)")
    own = sorted({*found.frames.values(), *(camera_frame(camera, frames, found.first) for camera in found.cameras)})
    used, given = set[str](), {clean_frame(child) for row in found.rig_file.transforms.values() for child in row}
    sensors: Sequence[Assigned] = (*found.lidars, *found.cameras)
    for last in (site, *own, *(clean_frame(one.entry.parent) for one in sensors)):
        while last not in used and (edge := found.transforms.fixed.edge(last)) is not None:
            used.add(last)
            last = edge.dst
    if sways := {child: sway for child, sway in found.transforms.swaying.items() if child in used}:
        turn_deg = max(sway.turn_deg for sway in sways.values())
        shift_m = max(sway.shift_m for sway in sways.values())
        notes.append(
            f"on tf, {listed(sorted(sways))} move by up to {turn_deg:.1f} degrees and {100 * shift_m:.0f} cm: the mean "
            "poses are used"
        )
    if given and not given & used:
        notes.append(
            f"no sensor needs the transforms of the rig file, to {listed(sorted(given))}: the sensors "
            f"are in {listed(own)}"
        )
    return notes


def _with_own_frames(rig: Rig, notes: list[str]) -> Rig:
    """The rig, whose cameras have frames of their own: as drivers come, several may share a name."""
    placed = {lidar.T_site_lidar.src: lidar.T_site_lidar.matrix for lidar in rig.lidars}
    cameras, names = list[CameraSensor](), dict[str, list[str]]()
    for camera in rig.cameras:
        pose, frame = camera.T_camera_site, camera.T_camera_site.dst
        T_site_camera = pose.inverse().matrix
        if not np.allclose(placed.setdefault(frame, T_site_camera), T_site_camera, atol=1e-6):
            own = f"{frame}_{camera.name}"
            camera = replace(camera, T_camera_site=Transform(own, pose.src, pose.matrix))
            notes.append(f"{camera.name}: another sensor has its frame {frame}, too; in the result it is {own}")
        cameras.append(camera)
        names.setdefault(camera.T_camera_site.dst, []).append(camera.name)
    notes += [
        f"{', '.join(shared)}: all in frame {frame} and so in one place: if they are several cameras, give each its "
        "pose in a rig file (--rig)"
        for frame, shared in names.items()
        if len(shared) > 1
    ]
    return replace(rig, cameras=tuple(cameras))


def _with_clocks_set(rig: Rig, found: FoundSensors) -> tuple[Rig, int, list[str]]:
    """The rig with offsets of clocks that were not set, where no rig file gives one; the usual delay, and notes."""
    sensors: Sequence[Assigned] = (*found.lidars, *found.cameras)
    given = {one.name for one in sensors if "time_offset_ms" in one.entry.model_fields_set}
    topics = {lidar.name: (lidar.topic, CLOUD) for lidar in rig.lidars}
    topics |= {one.name: (one.topic, IMAGE) if one.topic else (one.boxes_topic, BOXES) for one in rig.cameras}
    known = {topic: found.first.delay_ns(topic, types) for name, (topic, types) in topics.items() if name not in given}
    known |= {topic: stamped_delay_ns(found.recording, topic) for topic, delay_ns in known.items() if delay_ns is None}
    delays_ns = {topic: delay_ns for topic, delay_ns in known.items() if delay_ns is not None}
    usual_ns = usual_delay_ns(delay_ns or 0 for delay_ns in known.values())
    offsets_ns = clock_offsets(found.recording, delays_ns, usual_ns)
    moved = {name: offsets_ns[topic] for name, (topic, _) in topics.items() if topic in offsets_ns}
    lidars = tuple(replace(one, time_offset_ns=moved.get(one.name, one.time_offset_ns)) for one in rig.lidars)
    cameras = tuple(replace(one, time_offset_ns=moved.get(one.name, one.time_offset_ns)) for one in rig.cameras)
    notes = [clock_note(name, offset_ns) for name, offset_ns in moved.items()]
    return replace(rig, lidars=lidars, cameras=cameras), usual_ns, notes


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
    """Refuse poses of the rig file in a frame without a name: where the other sensors are in it is unknown."""
    if found.is_site_named or not found.lidars:  # without a lidar there is a worse fault to report
        return
    sensors: Sequence[Assigned] = (*found.lidars, *found.cameras)
    if posed := [one.name for one in sensors if one.entry.has_pose and not one.entry.parent]:
        raise CalibrationError(
            f"site_frame is missing in the rig file: name the frame that the pose of {listed(posed)} "
            f"is given in; where the lidars ({', '.join(one.name for one in found.lidars)}) are in it has to be "
            "known, from tf or from their poses in the rig file"
        )


def _no_lidar(faults: Sequence[SensorFault], site: str, *, can_decode: bool = True) -> str:
    reasons = "; ".join(f"{fault.sensor} ({fault.topic}): {fault.reason}" for fault in faults)
    if all("pip install" in fault.reason for fault in faults):
        return f"no lidar is usable on this machine: {reasons}"
    if not site:  # none of them was recorded, so poses would not help
        return f"no lidar is usable in this recording: {reasons}; correct topics.lidars, or the lidars of the rig file"
    if not can_decode:
        return f"no lidar is usable in this recording: {reasons}"
    return (
        f"no lidar is usable in site frame {site!r}: {reasons}; give the lidars' poses in a rig file (--rig), "
        "or another site frame (--set rig.site_frame=FRAME)"
    )
