"""The calibration of one sensor, from its entry in the rig file and from the recording.

What is missing or not valid raises a `CalibrationError`; a `FrameError` says that tf does not join the frames, a
`MessageError` that no message of the sensor, or no CameraInfo of it, can be decoded.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.errors import CalibrationError, FrameError
from lidcam.pipeline.core.geometry.transform import Transform, rotation_fault
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor
from lidcam.readers.messages.tf import RecordedTransforms, clean_frame
from lidcam.readers.rig.assignment import AssignedCamera, AssignedLidar
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.lens import MAX_OFF_CENTER, RIG_FILE, camera_intrinsics, decompose_projection, off_center
from lidcam.readers.rig.schema import POSE, CameraEntry, LidarEntry
from lidcam.readers.rig.sensor_topics import BOXES, CAMERA_INFO, CLOUD, IMAGE

OWN_SITE = "its frame is the site frame"
"""Source of the pose of a sensor in the site frame."""

MAX_AWAY_M = 2e5
"""Largest coordinate of a lidar in the site frame, where points in single precision have steps of 16 mm; those of the
squares of MGRS end at half of it, those of UTM are of half a metre."""

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
    """A lidar with the pose of the rig file, else of tf."""
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
        SensorSource(lidar.name, lidar.topic, frame, "", source),
    )


def calibrate_camera(
    camera: AssignedCamera, frames: Frames, first: FirstMessages
) -> tuple[CameraSensor, SensorSource, str]:
    """A camera with intrinsics of the rig file, else of CameraInfo, and extrinsics of the rig file, else of tf.

    The third item is a remark on them; it may be empty.
    """
    topics = camera.topics
    if topics.image:
        first.decoded(topics.image, IMAGE)
    check_complete(camera.entry)
    lens = camera_intrinsics(camera.entry, topics, camera_frame(camera, frames, first), first)
    T_camera_site, extrinsics = camera_extrinsics(camera, lens.T_model_camera.src, frames)
    pose, entry = lens.T_model_camera @ T_camera_site, camera.entry
    remarks = [lens.remark]
    if extrinsics.endswith(OF_BODY):
        frame = lens.model.frame_id
        remarks.append(f"as an optical frame, {frame} looks at the sky: taken as the frame of its body, x forward")
    if off_center(lens.model) > MAX_OFF_CENTER:
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
        SensorSource(camera.name, topics.topic, lens.model.frame_id, lens.source, extrinsics),
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


def camera_frame(camera: AssignedCamera, frames: Frames, first: FirstMessages) -> str:
    """The frame of a camera: as the rig file says, else CameraInfo, its images or its boxes; empty if none does.

    A frame that tf lacks gives way to the first of the others that tf joins with the site frame.
    """
    topics, of_rig = camera.topics, clean_frame(camera.entry.frame_id)
    kinds = (topics.info, CAMERA_INFO), (topics.image, IMAGE), (topics.boxes, BOXES)
    named = [name for topic, kind in kinds if topic and (name := first.frame(topic, kind))]
    joined = (name for name in named if frames.transforms.are_joined(frames.site, name))
    return of_rig or next(joined, named[0] if named else "")


def camera_extrinsics(camera: AssignedCamera, frame: str, frames: Frames) -> tuple[Transform, str]:
    """T_camera_site and its source; `frame` is the camera's.

    A frame of tf that looks up into the sky if taken as an optical one is that of the camera's body (REP 103: x
    forward, z up), with which many drivers stamp images.
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
