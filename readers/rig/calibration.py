"""The calibration of one sensor, from its entry in the rig file and from the recording."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError, FrameError
from lidcam.pipeline.core.geometry.transform import Transform, rotation_fault
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.camera_info import (
    camera_model,
    distortion_model,
    other_camera_model,
    rectified_camera_model,
    rectified_reason,
)
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.schema import POSE, CameraEntry, LidarEntry
from lidcam.readers.rig.sensor_topics import BOXES, CAMERA_INFO, CLOUD, IMAGE, CameraTopics
from lidcam.readers.rig.topic_names import is_rectified, transport_free

MAX_ROUNDING = 1e-6
"""Largest deviation of an exact matrix; a rotation with a larger one was rounded and becomes the nearest rotation."""


def rigid_transform(name: str, dst: str, src: str, values: npt.ArrayLike) -> Transform:
    """T_dst_src from sixteen numbers.

    A rotation that was rounded to a few digits becomes the nearest rotation (polar decomposition), because `inverse`
    transposes it.

    Raises:
        CalibrationError: the matrix is not rigid; says what is wrong with `name`.
    """
    matrix = np.array(values, np.float64).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise CalibrationError(f"{name} holds numbers that are not finite")
    if fault := rotation_fault(matrix[:3, :3]):
        raise CalibrationError(f"the rotation of {name} is not valid: {fault}")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > MAX_ROUNDING:
        raise CalibrationError(f"the last row of {name} is {matrix[3].tolist()}: expected 0 0 0 1")
    if dst == src and np.abs(matrix - np.eye(4)).max() > MAX_ROUNDING:
        raise CalibrationError(f"{name} moves frame {dst!r} against itself: give the sensor or the site another frame")
    matrix[3] = [0, 0, 0, 1]
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > MAX_ROUNDING:
        u, _, vt = np.linalg.svd(rotation)
        matrix[:3, :3] = u @ vt
    return Transform(dst, src, matrix)


def decompose_projection(name: str, values: npt.ArrayLike) -> tuple[F64, F64]:
    """K (3, 3) with K[2, 2] = 1 and T_camera_site (4, 4) of a projection P = s K [R | t], depth positive in front.

    By RQ decomposition (Hartley and Zisserman, Multiple View Geometry, 6.2.4).

    Raises:
        CalibrationError: P[:, :3] is singular or mirrored.
    """
    P = np.array(values, np.float64).reshape(3, 4)
    if not np.isfinite(P).all():
        raise CalibrationError(f"{name} holds numbers that are not finite")
    scale = float(np.linalg.norm(P[2, :3]))
    if scale < 1e-12 or abs(np.linalg.det(P[:, :3] / np.abs(P[:, :3]).max())) < 1e-12:
        raise CalibrationError(f"{name} is singular: its left 3 x 3 part has determinant 0, so it projects nothing")
    P = P / scale
    if np.linalg.det(P[:, :3]) < 0:
        raise CalibrationError(f"{name} is mirrored (negative determinant): expected depth that is positive in front")
    from scipy.linalg import rq  # a fifth of a second, for cameras whose pose is in P alone

    K, R = rq(P[:, :3])
    signs = np.where(np.diag(K) < 0, -1.0, 1.0)
    K, R = K * signs, signs[:, None] * R
    matrix = np.eye(4)
    matrix[:3, :3] = R
    matrix[:3, 3] = np.linalg.solve(K, P[:, 3])
    return np.asarray(K / K[2, 2], np.float64), matrix


OWN_SITE = "its frame is the site frame"
"""Source of the pose of a sensor in the site frame."""

RIG_FILE = "rig file"
"""Source of what the rig file gives."""

MAX_AWAY_M = 2e5
"""Largest coordinate of a lidar in the site frame, where points in single precision have steps of 16 mm; those of the
squares of MGRS end at half of it, those of UTM are of half a metre."""

MAX_OFF_CENTER = 0.25
"""Largest distance of a principal point from the middle of an image that is not cropped, as a share of its size."""

PARTS = {
    **dict.fromkeys(("T_site_lidar", "T_camera_site", "T_site_camera", *POSE), ("extrinsics",)),
    **dict.fromkeys(("K", "distortion", "distortion_model"), ("intrinsics",)),
    **dict.fromkeys(("width_px", "height_px"), ("image size",)),
    "P": ("intrinsics", "extrinsics"),
}
"""Parts of the calibration that a key of a rig file belongs to."""

MIN_UP = 0.5
"""Minimum upward component of a viewing direction from which the frame is taken to be that of the camera's body, which
then looks down by up to 60 degrees."""

OPTICAL_OF_BODY = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""T_optical_body of REP 103."""

OF_BODY = " (x forward)"
"""Follows the source of extrinsics that are those of the camera's body."""


@dataclass(frozen=True, slots=True)
class SensorSource:
    """Sources of a sensor's calibration; `intrinsics` is empty for a lidar."""

    sensor: str
    topic: str
    frame_id: str
    intrinsics: str
    extrinsics: str
    time_offset_ms: float = 0.0


@dataclass(frozen=True, slots=True)
class Frames:
    """Poses of frames in the site; see `FoundSensors`. `sensors` holds T_site_sensor of each calibrated sensor."""

    site: str
    transforms: RecordedTransforms
    of_rig: Collection[str] = ()
    sensors: dict[str, Transform] = field(default_factory=dict)

    def origin(self, parent: str) -> Transform:
        """T_site_parent of the parent of a pose; without one, the site frame itself."""
        if not parent:
            return Transform.identity(self.site, self.site)
        if parent in self.sensors:
            return self.sensors[parent]
        try:
            return self.transforms.lookup(self.site, clean_frame(parent))
        except FrameError as err:
            raise FrameError(
                f"its pose refers to {parent}: {err}; give the pose of {parent} in a rig file (transforms: "
                f"{{{self.site}: {{{parent}: {{translation_m: [x, y, z], rpy_deg: [r, p, y]}}}}}})"
            ) from err

    def recorded(self, dst: str, src: str) -> Transform:
        """T_dst_src by the transforms."""
        try:
            return self.transforms.lookup(dst, src)
        except FrameError as err:
            known = self.transforms.fixed.frames
            other = "" if known else "name the file with /tf_static beside this one, "
            if alike := sorted(one for one in known for name in {dst, src} - known if one.endswith(f"/{name}")):
                other = f"name the frames as tf does ({', '.join(alike)}) with frame_id in a rig file (--rig), or "
            remedy = f"{other}give its pose in a rig file (--rig), or --set 'topics.exclude=[TOPIC]'"
            raise FrameError(f"{err}; {remedy}") from err

    def source(self, frame: str) -> str:
        """Source of the transforms from a frame to the site frame."""
        tree = self.transforms.fixed
        links = {*tree.chain(frame)} ^ {*tree.chain(self.site)}
        of_rig = links & {*self.of_rig}
        words = "tf" if not of_rig else "rig file" if of_rig == links else "rig file and tf"
        return f"{words}: {self.site} <- {frame}"


def calibrate_lidar(
    lidar: AssignedLidar, frame: str, frames: Frames, first: FirstMessages
) -> tuple[LidarSensor, SensorSource]:
    """A lidar with the pose of the rig file, else of tf.

    Raises:
        CalibrationError: the pose is missing or not valid.
        FrameError: tf does not join the frames.
        MessageError: no cloud of the lidar can be decoded.
    """
    first.decoded(lidar.topic, CLOUD)
    entry, site = lidar.entry, frames.site
    check_complete(entry)
    if entry.has_pose:
        values = entry.matrix() if entry.T_site_lidar is None else entry.T_site_lidar
        origin = frames.origin(entry.parent)
        name = "its pose" if entry.T_site_lidar is None else "T_site_lidar"
        pose = rigid_transform(name, origin.src, frame, values)
        T_site_lidar = origin @ pose if entry.parent else pose  # to the bit as it was given
        source = _rig_source(entry)
    elif site == frame:
        T_site_lidar, source = Transform.identity(site, frame), OWN_SITE
    else:
        T_site_lidar, source = frames.recorded(site, frame), frames.source(frame)
    if (away_m := np.abs(T_site_lidar.translation).max()) > MAX_AWAY_M:
        raise CalibrationError(
            f"it is {away_m / 1000:.0f} km from the origin of the site frame {site!r}, expected at most "
            f"{MAX_AWAY_M / 1000:.0f} km, as points have seven digits: take a frame near the sensors (rig.site_frame), "
            "or the poses less the place of one of them"
        )
    return (
        LidarSensor(lidar.name, lidar.topic, T_site_lidar, entry.time_offset_ns),
        SensorSource(lidar.name, lidar.topic, frame, "", source, entry.time_offset_ms),
    )


def calibrate_camera(
    camera: AssignedCamera, frames: Frames, first: FirstMessages
) -> tuple[CameraSensor, SensorSource, str]:
    """A camera with intrinsics of the rig file, else of CameraInfo, and extrinsics of the rig file, else of tf.

    The third item is a remark on them; it may be empty.

    Raises:
        CalibrationError: one of them is missing or not valid.
        FrameError: tf does not join the frames.
        MessageError: no image, or no CameraInfo, of the camera can be decoded.
    """
    topics = camera.topics
    if topics.image:
        first.decoded(topics.image, IMAGE)
    check_complete(camera.entry)
    lens = camera_intrinsics(camera, frames, first)
    T_camera_site, extrinsics = camera_extrinsics(camera, lens.T_model_camera.src, frames)
    pose, entry = lens.T_model_camera @ T_camera_site, camera.entry
    remarks = [lens.remark]
    if extrinsics.endswith(OF_BODY):
        frame = lens.model.frame_id
        remarks.append(f"as an optical frame, {frame} looks at the sky: taken as the frame of its body, x forward")
    if _off_center(lens.model) > MAX_OFF_CENTER:
        (x, y), size = lens.model.K[:2, 2], f"{lens.model.width_px} x {lens.model.height_px} px"
        remarks.append(
            f"its principal point ({x:.0f}, {y:.0f}) is far from the middle of its images of {size}: unless they are "
            "cropped, its K is for images of another size"
        )
    sensor = CameraSensor(camera.name, topics.image, topics.boxes, lens.model, pose, entry.time_offset_ns)
    if lens.rectified is not None:
        model, T_model_camera = lens.rectified
        other = replace(sensor, model=model, T_camera_site=T_model_camera @ T_camera_site)
        sensor = replace(sensor, rectified=other)
    return (
        sensor,
        SensorSource(camera.name, topics.topic, lens.model.frame_id, lens.source, extrinsics, entry.time_offset_ms),
        "; ".join(filter(None, remarks)),
    )


def check_complete(entry: LidarEntry | CameraEntry, *parts: str) -> None:
    """Check that the keys of a sensor in the rig file have values; of `intrinsics` or `extrinsics` alone if given.

    Raises:
        CalibrationError: one has none; says which part is missing, and why.
    """
    reasons: dict[str, dict[str, None]] = {}
    for key, reason in entry.missing.items():
        missing = PARTS.get(key, (key,))
        if not parts or {*parts} & {*missing}:
            reasons.setdefault(reason, {}).update(dict.fromkeys(missing))
    if reasons:
        raise CalibrationError("; ".join(f"{_are(names)} {reason}" for reason, names in reasons.items()))


def _are(names: Iterable[str]) -> str:
    text = " and ".join(names)
    return f"{text} {'are' if text.endswith('s') else 'is'}"


class Lens(NamedTuple):
    """A camera's intrinsics, and T_model_camera: rectified images have axes of their own."""

    model: CameraModel
    T_model_camera: Transform
    source: str
    remark: str = ""  # What CameraInfo says otherwise
    # Another model and T_model_camera: of rectified images, where CameraInfo does not tell whether they are
    rectified: tuple[CameraModel, Transform] | None = None


def camera_frame(camera: AssignedCamera, frames: Frames, first: FirstMessages) -> str:
    """The frame of a camera: as the rig file says, else CameraInfo, its images or its boxes; empty if none does.

    A frame that tf lacks gives way to the first of the others that tf joins with the site frame.
    """
    topics, of_rig = camera.topics, clean_frame(camera.entry.frame_id)
    kinds = (topics.info, CAMERA_INFO), (topics.image, IMAGE), (topics.boxes, BOXES)
    named = [name for topic, kind in kinds if topic and (name := first.frame(topic, kind))]
    joined = (name for name in named if frames.transforms.are_joined(frames.site, name))
    return of_rig or next(joined, named[0] if named else "")


def recorded_size(topics: CameraTopics, first: FirstMessages) -> tuple[int, int] | None:
    """(width, height) in pixels of a camera's images, else as CameraInfo says; None if nothing does."""
    size = first.image_size(topics.image, IMAGE) if topics.image else None
    return size or (first.image_size(topics.info, CAMERA_INFO) if topics.info else None)


def camera_intrinsics(camera: AssignedCamera, frames: Frames, first: FirstMessages) -> Lens:
    """Intrinsics of the rig file, else of CameraInfo.

    Raises:
        CalibrationError: they are missing or not valid, or not for images of the recorded size.
        MessageError: no CameraInfo of the camera can be decoded.
    """
    entry, topics, frame = camera.entry, camera.topics, camera_frame(camera, frames, first)
    if {"K", "P", "camera_info"} & entry.given:
        frame = frame or f"{transport_free(topics.topic).strip('/').replace('/', '_')}_optical"
    if {"K", "P"} & entry.given:
        lens = Lens(_model_of_entry(entry, topics, frame, first), Transform.identity(frame, frame), RIG_FILE)
    else:
        lens = _lens_of_info(entry, topics, frame, first)
    size = first.image_size(topics.image, IMAGE) if topics.image else None
    if size is None or size == (lens.model.width_px, lens.model.height_px):
        return lens
    scaled = None if lens.source == RIG_FILE else _scaled(lens.model, *size)
    if scaled is None:
        raise CalibrationError(
            f"its images are {size[0]} x {size[1]} px, but the calibration ({lens.source}) is for "
            f"{lens.model.width_px} x {lens.model.height_px} px"
        )
    said = f"{_source_of_info(entry, topics)} is for {lens.model.width_px} x {lens.model.height_px} px"
    remarks = [lens.remark, f"{said}, its images are {size[0]} x {size[1]}: the calibration is scaled"]
    return Lens(scaled, lens.T_model_camera, f"{lens.source}, scaled", "; ".join(filter(None, remarks)))


def _scaled(model: CameraModel, width_px: int, height_px: int) -> CameraModel | None:
    """The model for images scaled to a size by one factor, to a pixel.

    None if the size has another shape, or if the principal point says that the calibration's own size is wrong.
    """
    factor = width_px / model.width_px
    if abs(height_px - factor * model.height_px) > 1 or _off_center(model) > MAX_OFF_CENTER:
        return None
    scale = np.array([factor, height_px / model.height_px])
    K = model.K.copy()
    K[:2] *= scale[:, None]
    K[:2, 2] += (scale - 1) / 2  # principal points count from the centre of the first pixel
    return CameraModel(model.frame_id, width_px, height_px, K, model.model, model.distortion)


def _off_center(model: CameraModel) -> float:
    """Distance of the principal point from the middle of the image, as a share of its size."""
    center = (model.K[:2, 2] + 0.5) / [model.width_px, model.height_px]
    return float(np.abs(center - 0.5).max())


def camera_extrinsics(camera: AssignedCamera, frame: str, frames: Frames) -> tuple[Transform, str]:
    """T_camera_site and its source; `frame` is the camera's.

    A frame of tf that looks up into the sky if taken as an optical one is that of the camera's body (REP 103: x
    forward, z up), with which many drivers stamp images.

    Raises:
        CalibrationError: the pose is missing or not valid.
        FrameError: tf does not join the frames.
    """
    entry = camera.entry
    if not entry.has_pose:
        if not frame:
            raise CalibrationError("no message of it names its frame: give its pose in a rig file (--rig)")
        pose = frames.recorded(frame, frames.site)
        if "optical" in frame.lower() or pose.matrix[2, 2] < MIN_UP:
            return pose, frames.source(frame)
        return replace(pose, matrix=OPTICAL_OF_BODY @ pose.matrix), f"{frames.source(frame)}{OF_BODY}"
    origin = frames.origin(entry.parent)
    if entry.P is not None:
        pose = rigid_transform("P's pose", frame, origin.src, decompose_projection("P", entry.P)[1])
    elif entry.T_camera_site is not None:
        pose = rigid_transform("T_camera_site", frame, origin.src, entry.T_camera_site)
    elif entry.T_site_camera is not None:
        pose = rigid_transform("T_site_camera", origin.src, frame, entry.T_site_camera).inverse()
    else:
        pose = rigid_transform("its pose", origin.src, frame, entry.matrix()).inverse()
    return pose @ origin.inverse() if entry.parent else pose, _rig_source(entry)


def _rig_source(entry: LidarEntry | CameraEntry) -> str:
    return f"{RIG_FILE}, by {entry.parent}" if entry.parent else RIG_FILE


def _model_of_entry(entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages) -> CameraModel:
    width, height = entry.width_px, entry.height_px
    if width is None or height is None:
        size = recorded_size(topics, first)
        if size is None:
            raise CalibrationError("the recording does not say how large its images are: give width_px and height_px")
        width, height = size
    K = np.array(entry.K, np.float64).reshape(3, 3) if entry.P is None else decompose_projection("P", entry.P)[0]
    model, coefficients = distortion_model(entry.distortion_model, entry.distortion)
    return CameraModel(frame, width, height, K, model, coefficients)


def _source_of_info(entry: CameraEntry, topics: CameraTopics) -> str:
    return RIG_FILE if entry.camera_info else topics.info


def _lens_of_info(entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages) -> Lens:
    if entry.camera_info:
        info = ROS2.camera_info(0, "", width=entry.width_px, height=entry.height_px, **entry.camera_info)  # type: ignore[arg-type]  # by field
    elif topics.info:
        info = first.decoded(topics.info, CAMERA_INFO)
    else:
        raise CalibrationError(
            "the recording has no CameraInfo of it: give its K in a rig file (--rig; inspect --write-rig drafts one)"
        )
    source, remark, other = _source_of_info(entry, topics), "", None
    if is_rectified(topics.image):
        model, T_model_camera = rectified_camera_model(info, frame_id=frame)
    elif reason := rectified_reason(info):
        model, T_model_camera = rectified_camera_model(info, frame_id=frame, is_turned=False)
        source = f"P of {source}"
        remark = f"{source} is used, without distortion: {reason}"
    else:
        model, T_model_camera = camera_model(info, frame_id=frame), Transform.identity(frame, frame)
        other = other_camera_model(info, model)
    if (entry.width_px or model.width_px, entry.height_px or model.height_px) != (model.width_px, model.height_px):
        raise CalibrationError(
            f"the rig file says images of {entry.width_px} x {entry.height_px} px, {source} says "
            f"{model.width_px} x {model.height_px} px"
        )
    words = model.model if model.distortion.any() else "no distortion"
    return Lens(model, T_model_camera, f"{source} ({words})", remark, other)
