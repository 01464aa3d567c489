"""A rig to start from: every sensor of a recording, with what is known of its calibration and why the rest is not."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from pipeline.core.camera import CameraModel
from pipeline.core.errors import LidcamError
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import TruthVehicle, Zone
from readers.rig.assignment import AssignedCamera, AssignedLidar
from readers.rig.calibration import (
    Frames,
    Lens,
    calibrate_lidar,
    camera_extrinsics,
    camera_frame,
    camera_intrinsics,
    check_complete,
    recorded_size,
)
from readers.rig.discovery import calibrated_rig, parents_first
from readers.rig.first_messages import FirstMessages
from readers.rig.search import FoundSensors
from readers.rig.sensor_topics import CLOUD

__all__ = ["DraftCamera", "DraftLidar", "RigDraft", "draft_rig"]

T = TypeVar("T")

UNKNOWN_SITES = ("site", "world", "rig_site")
"""Names of a site frame that nothing names; the first one that no other frame has is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class DraftLidar:
    """One lidar.

    Attributes:
        name: Its name.
        topic: Its topic.
        msgtype: Type of its messages.
        size: How large its first message is, in words.
        frame_id: Its frame.
        T_site_lidar: Its extrinsics; None if unknown.
        problem: Why they are unknown.
        time_offset_ns: Recorded stamp minus time of measurement.
    """

    name: str
    topic: str
    msgtype: str
    size: str
    frame_id: str
    T_site_lidar: Transform | None
    problem: str
    time_offset_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class DraftCamera:
    """One camera.

    Attributes:
        name: Its name.
        topic: Topic of its images; empty if it has none.
        boxes_topic: Topic of its boxes; empty if it has none.
        msgtype: Type of its messages.
        size_px: Width and height of its images; None if unknown.
        frame_id: Its frame; empty if unknown.
        model: Its intrinsics; None if unknown.
        model_problem: Why they are unknown.
        T_camera_site: Its extrinsics; None if unknown.
        pose_problem: Why they are unknown.
        time_offset_ns: Recorded stamp minus time of measurement.
    """

    name: str
    topic: str
    boxes_topic: str
    msgtype: str
    size_px: tuple[int, int] | None
    frame_id: str
    model: CameraModel | None
    model_problem: str
    T_camera_site: Transform | None
    pose_problem: str
    time_offset_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class RigDraft:
    """All sensors that were found.

    Attributes:
        site_frame: The site frame.
        site_source: Why it is the site frame, in words.
        ground_height_m: Expected z of the ground at the site's origin; None if unknown.
        lidars: In the order of processing.
        cameras: In the order of processing.
        zones: Parts of the site.
        transforms: Of the rig file, as it says them, by its keys `transforms` and `default_transforms`.
        truth: Vehicles whose odometry is truth, of the rig file.
    """

    site_frame: str
    site_source: str
    ground_height_m: float | None
    lidars: tuple[DraftLidar, ...]
    cameras: tuple[DraftCamera, ...]
    zones: tuple[Zone, ...]
    transforms: Mapping[str, Any]
    truth: Mapping[str, TruthVehicle]


def draft_rig(found: FoundSensors) -> RigDraft:
    """A rig with every sensor that was found, whether or not its calibration is known."""
    try:
        calibrated_rig(found)
    except LidcamError:
        taken = found.transforms.fixed.frames | {*found.frames.values()}
        site = found.site if found.is_site_named else next(name for name in UNKNOWN_SITES if name not in taken)
        source = (
            "" if found.is_site_named else "no frame of the recording is known to be it: poses are to be given in it"
        )
    else:
        owners = [name for name, frame in found.frames.items() if frame == found.site]
        of_lidar = f"the frame of {owners[0]}" if owners else "as found in the recording"
        site, source = found.site, "" if found.is_site_named else of_lidar
    frames = Frames(site, found.transforms, found.of_rig)
    lidars: dict[str, DraftLidar] = {}
    cameras: dict[str, DraftCamera] = {}
    for sensor in parents_first((*found.lidars, *found.cameras)):
        if isinstance(sensor, AssignedLidar):
            lidars[sensor.name] = _lidar(sensor, frames, found)
        else:
            cameras[sensor.name] = _camera(sensor, frames, found)
    return RigDraft(
        site,
        source,
        found.rig_file.ground_height_m,
        tuple(lidars[lidar.name] for lidar in found.lidars),
        tuple(cameras[camera.name] for camera in found.cameras),
        found.zones,
        found.rig_file.model_dump(mode="json", include={"transforms", "default_transforms"}, exclude_none=True),
        found.rig_file.vehicles,
    )


def _lidar(lidar: AssignedLidar, frames: Frames, found: FoundSensors) -> DraftLidar:
    frame = found.frames[lidar.name]
    result, problem = _tried(lambda: calibrate_lidar(lidar, frame, frames, found.first))
    pose = None if result is None else result[0].T_site_lidar
    if pose is not None:
        frames.sensors[lidar.name] = pose
    return DraftLidar(
        lidar.name,
        lidar.topic,
        _msgtype(found, lidar.topic),
        _size(found, lidar.topic),
        frame,
        pose,
        problem,
        lidar.entry.time_offset_ns,
    )


def _camera(camera: AssignedCamera, frames: Frames, found: FoundSensors) -> DraftCamera:
    first, topics = found.first, camera.topics
    lens, lens_problem = _tried(lambda: _complete_lens(camera, first))
    frame = camera_frame(camera, first) if lens is None else lens.T_model_camera.src
    pose, pose_problem = _tried(lambda: _complete_pose(camera, frame, frames))
    if pose is not None:
        pose = pose if lens is None else lens.T_model_camera @ pose
        frames.sensors[camera.name] = pose.inverse()
    size = recorded_size(topics, first)
    if size is None and lens is not None:
        size = lens.model.width_px, lens.model.height_px
    return DraftCamera(
        camera.name,
        topics.image,
        topics.boxes,
        _msgtype(found, topics.topic),
        size,
        frame if lens is None else lens.model.frame_id,
        None if lens is None else lens.model,
        lens_problem,
        pose,
        pose_problem,
        camera.entry.time_offset_ns,
    )


def _complete_lens(camera: AssignedCamera, first: FirstMessages) -> Lens:
    check_complete(camera.entry, "intrinsics")
    return camera_intrinsics(camera, first)


def _complete_pose(camera: AssignedCamera, frame: str, frames: Frames) -> Transform:
    check_complete(camera.entry, "extrinsics")
    return camera_extrinsics(camera, frame, frames)[0]


def _tried(find: Callable[[], T]) -> tuple[T | None, str]:
    """The value, or None and why there is none."""
    try:
        return find(), ""
    except LidcamError as err:
        return None, str(err)


def _msgtype(found: FoundSensors, topic: str) -> str:
    return next((info.msgtype for info in found.recording.topics if info.topic == topic), "")


def _size(found: FoundSensors, topic: str) -> str:
    if found.first.missing(topic, CLOUD):
        return "messages that cannot be decoded"
    message, size = found.first.decoded(topic, CLOUD), found.first.image_size(topic, CLOUD)
    if hasattr(message, "packets"):
        return f"{len(message.packets)} packets in the first message"
    return f"{size[0] * size[1]} points in the first message" if size else "points"
