"""The calibration of one sensor, from its entry in the rig file and from the recording."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.camera import CameraModel
from pipeline.core.errors import CalibrationError
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, LidarSensor
from readers.messages.camera_info import camera_model, distortion_model, rectified_camera_model
from readers.messages.tf import RecordedTransforms, clean_frame
from readers.rig.assignment import AssignedCamera, AssignedLidar
from readers.rig.extrinsics import decompose_projection, rigid_transform
from readers.rig.first_messages import FirstMessages
from readers.rig.schema import CameraEntry
from readers.rig.sensor_topics import BOXES, CAMERA_INFO, CLOUD, IMAGE, CameraTopics
from readers.rig.topic_names import is_rectified, transport_free

__all__ = ["OWN_SITE", "SensorSource", "calibrate_camera", "calibrate_lidar"]

OWN_SITE = "its frame is the site frame"
"""Source of the pose of a lidar that has the site frame."""


@dataclass(frozen=True, slots=True)
class SensorSource:
    """Where a sensor's calibration was found.

    Attributes:
        sensor: Its name in the rig.
        topic: Its topic.
        frame_id: Its frame.
        intrinsics: Source of a camera's intrinsics; empty for a lidar.
        extrinsics: Source of its pose.
        time_offset_ms: What the rig file takes off its stamps.
    """

    sensor: str
    topic: str
    frame_id: str
    intrinsics: str
    extrinsics: str
    time_offset_ms: float = 0.0


def calibrate_lidar(
    lidar: AssignedLidar, frame: str, site: str, first: FirstMessages, transforms: RecordedTransforms
) -> tuple[LidarSensor, SensorSource]:
    """A lidar with the pose of the rig file, else of tf.

    Raises:
        CalibrationError: the pose is missing or not valid.
        FrameError: tf does not join the frames.
        MessageError: no cloud of the lidar can be decoded.
    """
    first.decoded(lidar.topic, CLOUD)
    entry = lidar.entry
    if entry.T_site_lidar is not None:
        T_site_lidar, source = rigid_transform("T_site_lidar", site, frame, entry.T_site_lidar), "rig file"
    elif (pose := entry.pose_in_site()) is not None:
        T_site_lidar, source = rigid_transform("its pose", site, frame, pose), "rig file"
    elif site == frame:
        T_site_lidar, source = Transform.identity(site, frame), OWN_SITE
    else:
        T_site_lidar, source = transforms.lookup(site, frame), f"tf: {site} <- {frame}"
    return (
        LidarSensor(lidar.name, lidar.topic, T_site_lidar, entry.time_offset_ns),
        SensorSource(lidar.name, lidar.topic, frame, "", source, entry.time_offset_ms),
    )


def calibrate_camera(
    camera: AssignedCamera, site: str, first: FirstMessages, transforms: RecordedTransforms
) -> tuple[CameraSensor, SensorSource]:
    """A camera with intrinsics of the rig file, else of CameraInfo, and extrinsics of the rig file, else of tf.

    Raises:
        CalibrationError: one of them is missing or not valid.
        FrameError: tf does not join the frames.
        MessageError: no image, or no CameraInfo, of the camera can be decoded.
    """
    entry, topics = camera.entry, camera.topics
    if topics.image:
        first.decoded(topics.image, IMAGE)
    frame = (
        clean_frame(entry.frame_id)
        or (topics.info and first.frame(topics.info, CAMERA_INFO))
        or (topics.image and first.frame(topics.image, IMAGE))
        or (topics.boxes and first.frame(topics.boxes, BOXES))
    )
    if entry.P is not None or entry.K is not None:
        frame = frame or f"{transport_free(topics.topic).strip('/').replace('/', '_')}_optical"
        model, from_projection = _model_of_entry(entry, topics, frame, first)
        T_model_camera, intrinsics = Transform.identity(frame, frame), "rig file"
    else:
        model, T_model_camera = _model_of_info(entry, topics, frame, first)
        from_projection = None
        intrinsics = f"{topics.info} ({model.model if model.distortion.any() else 'no distortion'})"
    size = first.image_size(topics.image, IMAGE) if topics.image else None
    if size is not None and size != (model.width_px, model.height_px):
        raise CalibrationError(
            f"its images are {size[0]} x {size[1]} px, but the calibration ({intrinsics}) is for "
            f"{model.width_px} x {model.height_px} px"
        )
    T_camera_site, extrinsics = _camera_pose(entry, from_projection, T_model_camera.src, site, transforms)
    return (
        CameraSensor(
            camera.name, topics.image, topics.boxes, model, T_model_camera @ T_camera_site, entry.time_offset_ns
        ),
        SensorSource(camera.name, topics.topic, model.frame_id, intrinsics, extrinsics, entry.time_offset_ms),
    )


def _model_of_entry(
    entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages
) -> tuple[CameraModel, F64 | None]:
    """The model, and T_camera_site (4, 4) if the entry gives P."""
    width, height = entry.width_px, entry.height_px
    if width is None or height is None:
        size = first.image_size(topics.image, IMAGE) if topics.image else None
        if size is None and topics.info:
            info = first.decoded(topics.info, CAMERA_INFO)
            size = int(info.width), int(info.height)
        if size is None:
            raise CalibrationError("the recording does not say how large its images are: give width_px and height_px")
        width, height = size
    if entry.P is not None:
        K, matrix = decompose_projection("P", entry.P)
    else:
        K, matrix = np.array(entry.K, np.float64).reshape(3, 3), None
    model, coefficients = distortion_model(entry.distortion_model, entry.distortion)
    return CameraModel(frame, width, height, K, model, coefficients), matrix


def _model_of_info(
    entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages
) -> tuple[CameraModel, Transform]:
    """The model, and T_model_camera: a rectified model has axes of its own."""
    if not topics.info:
        raise CalibrationError("the recording has no CameraInfo of it: give K and its pose in a rig file (--rig)")
    info = first.decoded(topics.info, CAMERA_INFO)
    if is_rectified(topics.image):
        model, T_model_camera = rectified_camera_model(info, frame_id=frame)
    else:
        model, T_model_camera = camera_model(info, frame_id=frame), Transform.identity(frame, frame)
    if (entry.width_px or model.width_px, entry.height_px or model.height_px) != (model.width_px, model.height_px):
        raise CalibrationError(
            f"the rig file says images of {entry.width_px} x {entry.height_px} px, {topics.info} says "
            f"{model.width_px} x {model.height_px} px"
        )
    return model, T_model_camera


def _camera_pose(
    entry: CameraEntry, from_projection: F64 | None, frame: str, site: str, transforms: RecordedTransforms
) -> tuple[Transform, str]:
    """T_camera_site and its source."""
    if from_projection is not None:
        return rigid_transform("P's pose", frame, site, from_projection), "rig file"
    if entry.T_camera_site is not None:
        return rigid_transform("T_camera_site", frame, site, entry.T_camera_site), "rig file"
    if entry.T_site_camera is not None:
        return rigid_transform("T_site_camera", site, frame, entry.T_site_camera).inverse(), "rig file"
    if (pose := entry.pose_in_site()) is not None:
        return rigid_transform("its pose", site, frame, pose).inverse(), "rig file"
    if not frame:
        raise CalibrationError("no message of it names its frame: give its pose in a rig file (--rig)")
    return transforms.lookup(frame, site), f"tf: {site} <- {frame}"
