"""A rig to start from: every sensor of a recording, with what is known of its calibration and why the rest is not."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from lidcam.pipeline.core.errors import LidcamError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import Zone
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar
from lidcam.readers.rig.calibration import Frames, calibrate_lidar, camera_extrinsics, camera_frame, check_complete
from lidcam.readers.rig.discovery import calibrated_rig, parents_first
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.lens import Lens, camera_intrinsics, recorded_size
from lidcam.readers.rig.rig_file import RIG_HEADER, Row, dumped, matrix_rows, time_offset, truth_tree, zone_tree
from lidcam.readers.rig.schema import TODO
from lidcam.readers.rig.search import FoundSensors
from lidcam.readers.rig.sensor_topics import CLOUD

T = TypeVar("T")

UNKNOWN_SITES = ("site", "world", "rig_site")
"""Names of a site frame that nothing names; the first one that no other frame has is taken."""


def draft_yaml(found: FoundSensors, zones: Sequence[Zone]) -> str:
    """The text of a rig file with every sensor that was found; what is not known is `TODO`, with the reason."""
    site, source = _site(found)
    frames = Frames(site, found.transforms, found.of_rig)
    entries: dict[str, list[str]] = {}
    for sensor in parents_first((*found.lidars, *found.cameras)):
        if isinstance(sensor, AssignedLidar):
            entries[sensor.name] = _lidar(sensor, frames, found)
        else:
            entries[sensor.name] = _camera(sensor, frames, found)
    file = found.rig_file
    lines = [RIG_HEADER.rstrip(), *_key("site_frame", site, source)]
    if file.ground_height_m is not None:
        lines += _key("ground_height_m", file.ground_height_m)
    sensors: tuple[tuple[str, Sequence[AssignedLidar | AssignedCamera]], ...]
    sensors = ("lidars", found.lidars), ("cameras", found.cameras)
    for kind, group in sensors:
        lines += [f"{kind}:" if group else f"{kind}: {{}}"]
        for one in group:
            lines += [f"  {one.name}:", *(f"    {line}" for line in entries[one.name])]
    lines += ["zones:" if zones else "zones: {}"]
    for zone in zones:
        lines += [f"  {line}" for line in _key(zone.name, zone_tree(zone))]
    edges = file.model_dump(mode="json", include={"transforms", "default_transforms"}, exclude_none=True)
    tree = {"truth": truth_tree(file.vehicles), **edges}
    lines += [dumped({key: value}).rstrip() for key, value in tree.items() if value]
    return "".join(f"{line}\n" for line in lines)


def _site(found: FoundSensors) -> tuple[str, str]:
    """The site frame, and why it is that in words; empty if the settings or the rig name it."""
    try:
        calibrated_rig(found)
    except LidcamError:
        if found.is_site_named:
            return found.site, ""
        taken = found.transforms.fixed.frames | {*found.frames.values()}
        unknown = next(name for name in UNKNOWN_SITES if name not in taken)
        return unknown, "no frame of the recording is known to be it: poses are to be given in it"
    if found.is_site_named:
        return found.site, ""
    owners = [name for name, frame in found.frames.items() if frame == found.site]
    return found.site, f"the frame of {owners[0]}" if owners else "as found in the recording"


def _lidar(lidar: AssignedLidar, frames: Frames, found: FoundSensors) -> list[str]:
    """The lines of a lidar; its pose, if it is known, goes into `frames`."""
    frame = found.frames[lidar.name]
    result, problem = _tried(lambda: calibrate_lidar(lidar, frame, frames, found.first))
    pose = None if result is None else result[0].T_site_lidar
    if pose is not None:
        frames.sensors[lidar.name] = pose
    return [
        *_key("topic", lidar.topic, f"{_msgtype(found, lidar.topic)}, {_size(found, lidar.topic)}"),
        *_key("frame_id", frame),
        *_pose("T_site_lidar", pose, problem),
        *_offset(lidar.entry.time_offset_ns),
    ]


def _camera(camera: AssignedCamera, frames: Frames, found: FoundSensors) -> list[str]:
    """The lines of a camera; its pose, if it is known, goes into `frames`."""
    first, topics = found.first, camera.topics
    lens, lens_problem = _tried(lambda: _complete_lens(camera, frames, first))
    frame = camera_frame(camera, frames, first) if lens is None else lens.T_model_camera.src
    pose, pose_problem = _tried(lambda: _complete_pose(camera, frame, frames))
    if pose is not None:
        pose = pose if lens is None else lens.T_model_camera @ pose
        frames.sensors[camera.name] = pose.inverse()
    size: tuple[Any, Any] | None = recorded_size(topics, first)
    if size is None:
        size = (TODO, TODO) if lens is None else (lens.model.width_px, lens.model.height_px)
    msgtype = _msgtype(found, topics.topic)
    lines = _key("topic", topics.image, msgtype) if topics.image else []
    if topics.boxes:
        lines += _key("boxes_topic", topics.boxes, "" if topics.image else msgtype)
    if model_frame := frame if lens is None else lens.model.frame_id:
        lines += _key("frame_id", model_frame)
    lines += [*_key("width_px", size[0]), *_key("height_px", size[1])]
    if lens is None:
        lines += _key("K", TODO, f"TODO 3 x 3, pixels; then distortion_model and distortion ({lens_problem})")
    else:
        lines += _key("K", matrix_rows(lens.model.K))
        lines += _key("distortion_model", lens.model.model)
        lines += _key("distortion", Row(lens.model.distortion.tolist()))
    return [*lines, *_pose("T_camera_site", pose, pose_problem), *_offset(camera.entry.time_offset_ns)]


def _complete_lens(camera: AssignedCamera, frames: Frames, first: FirstMessages) -> Lens:
    check_complete(camera.entry, "intrinsics")
    return camera_intrinsics(camera.entry, camera.topics, camera_frame(camera, frames, first), first)


def _complete_pose(camera: AssignedCamera, frame: str, frames: Frames) -> Transform:
    check_complete(camera.entry, "extrinsics")
    return camera_extrinsics(camera, frame, frames)[0]


def _tried(find: Callable[[], T]) -> tuple[T | None, str]:
    """The value, or None and why there is none."""
    try:
        return find(), ""
    except LidcamError as err:
        return None, str(err)


def _offset(offset_ns: int) -> list[str]:
    return [line for key, value in time_offset(offset_ns).items() for line in _key(key, value)]


def _pose(key: str, pose: Transform | None, problem: str) -> list[str]:
    if pose is not None:
        return _key(key, matrix_rows(pose.matrix))
    return _key(key, TODO, f"TODO 4 x 4, metres; or translation_m and rpy_deg in its place ({problem})")


def _key(key: str, value: Any, comment: str = "") -> list[str]:
    """Lines of one key, with a comment behind the first."""
    first, *more = dumped({key: value}, width=1000).splitlines()
    comment = "".join(letter if letter.isprintable() else " " for letter in comment)
    return [f"{first} # {comment}" if comment else first, *more]


def _msgtype(found: FoundSensors, topic: str) -> str:
    return next((info.msgtype for info in found.recording.topics if info.topic == topic), "")


def _size(found: FoundSensors, topic: str) -> str:
    if found.first.missing(topic, CLOUD):
        return "messages that cannot be decoded"
    message, size = found.first.decoded(topic, CLOUD), found.first.image_size(topic, CLOUD)
    if hasattr(message, "packets"):
        return f"{len(message.packets)} packets in the first message"
    return f"{size[0] * size[1]} points in the first message" if size else "points"
