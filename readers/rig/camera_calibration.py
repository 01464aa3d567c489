"""One camera's intrinsics and extrinsics, from its entry in the rig file and from the recording."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.camera import CameraModel
from pipeline.core.errors import CalibrationError
from pipeline.core.geometry.transform import Transform
from readers.messages.camera_info import camera_model, distortion_model, rectified_camera_model
from readers.messages.tf import RecordedTransforms, clean_frame
from readers.rig.extrinsics import decompose_projection, rigid_transform
from readers.rig.first_messages import FirstMessages
from readers.rig.rig_file import CameraEntry
from readers.rig.sensor_topics import BOXES, CAMERA_INFO, IMAGE, CameraTopics
from readers.rig.topic_names import is_rectified, transport_free

__all__ = ["CameraCalibration", "calibrate_camera"]


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """A camera's calibration, and where it was found."""

    model: CameraModel
    T_camera_site: Transform
    intrinsics: str
    extrinsics: str


def calibrate_camera(
    entry: CameraEntry, topics: CameraTopics, site: str, first: FirstMessages, transforms: RecordedTransforms
) -> CameraCalibration:
    """Intrinsics of the rig file, else of CameraInfo; extrinsics of the rig file, else of tf.

    Raises:
        CalibrationError: one of them is missing or unsound.
        MessageError: no image, or no CameraInfo, of the camera can be decoded.
    """
    if topics.image:
        first.decoded(topics.image, IMAGE)  # a camera none of whose images can be decoded is left out here
    frame = (
        clean_frame(entry.frame_id)
        or (topics.info and first.frame(topics.info, CAMERA_INFO))
        or (topics.image and first.frame(topics.image, IMAGE))
        or (topics.boxes and first.frame(topics.boxes, BOXES))
    )
    if entry.P is not None or entry.K is not None:
        frame = frame or f"{transport_free(topics.topic).strip('/').replace('/', '_')}_optical"
        model, from_projection = _model_of_entry(entry, topics, frame, first)
        turn, intrinsics = Transform.identity(frame, frame), "rig file"
    else:
        model, turn = _model_of_info(entry, topics, frame, first)
        from_projection = None
        intrinsics = f"{topics.info} ({model.model if model.distortion.any() else 'no distortion'})"
    size = first.image_size(topics.image, IMAGE) if topics.image else None
    if size is not None and size != (model.width_px, model.height_px):
        raise CalibrationError(
            f"its images are {size[0]} x {size[1]} px, but the calibration ({intrinsics}) is for "
            f"{model.width_px} x {model.height_px} px"
        )
    T_camera_site, extrinsics = _pose(entry, from_projection, turn.src, site, transforms)
    return CameraCalibration(model, turn @ T_camera_site, intrinsics, extrinsics)


def _model_of_entry(
    entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages
) -> tuple[CameraModel, F64 | None]:
    """The model, and T_camera_site (4, 4) where the entry gives P."""
    width, height = entry.width_px, entry.height_px
    if width is None or height is None:
        size = first.image_size(topics.image, IMAGE) if topics.image else None
        if size is None and topics.info:
            info = first.decoded(topics.info, CAMERA_INFO)
            size = int(info.width), int(info.height)
        if size is None:
            raise CalibrationError("the recording does not tell its image size: give width_px and height_px")
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
    """The model, and T_model_camera between the frames of the model and of the camera."""
    if not topics.info:
        raise CalibrationError("the recording has no CameraInfo of it: give K and its pose in a rig file (--rig)")
    info = first.decoded(topics.info, CAMERA_INFO)
    if is_rectified(topics.image):
        model, turn = rectified_camera_model(info, frame_id=frame)
    else:
        model, turn = camera_model(info, frame_id=frame), Transform.identity(frame, frame)
    if (entry.width_px or model.width_px, entry.height_px or model.height_px) != (model.width_px, model.height_px):
        raise CalibrationError(
            f"the rig file says images of {entry.width_px} x {entry.height_px} px, {topics.info} says "
            f"{model.width_px} x {model.height_px} px"
        )
    return model, turn


def _pose(
    entry: CameraEntry, from_projection: F64 | None, frame: str, site: str, transforms: RecordedTransforms
) -> tuple[Transform, str]:
    """T_camera_site and where it was found."""
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
