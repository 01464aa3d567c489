"""The intrinsics of one camera, from its entry in the rig file or from its CameraInfo; errors as of `calibration`."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.camera_info import (
    camera_model,
    distortion_model,
    other_camera_model,
    rectified_camera_model,
    rectified_reason,
)
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.schema import CameraEntry
from lidcam.readers.rig.sensor_topics import CAMERA_INFO, IMAGE, CameraTopics
from lidcam.readers.rig.topic_names import is_rectified, transport_free

RIG_FILE = "rig file"
"""Source of what the rig file gives."""

MAX_OFF_CENTER = 0.25
"""Largest distance of a principal point from the middle of an image that is not cropped, as a share of its size."""


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
    return np.asarray(K / K[2, 2], np.float64), pose_matrix(R, np.linalg.solve(K, P[:, 3]))


class Lens(NamedTuple):
    """A camera's intrinsics, and T_model_camera: rectified images have axes of their own."""

    model: CameraModel
    T_model_camera: Transform
    source: str
    remark: str = ""  # What CameraInfo says otherwise
    # Another model and T_model_camera: of rectified images, where CameraInfo does not tell whether they are
    rectified: tuple[CameraModel, Transform] | None = None


def recorded_size(topics: CameraTopics, first: FirstMessages) -> tuple[int, int] | None:
    """(width, height) in pixels of a camera's images, else as CameraInfo says; None if nothing does."""
    size = first.image_size(topics.image, IMAGE) if topics.image else None
    return size or (first.image_size(topics.info, CAMERA_INFO) if topics.info else None)


def camera_intrinsics(entry: CameraEntry, topics: CameraTopics, frame: str, first: FirstMessages) -> Lens:
    """Intrinsics of the rig file, else of CameraInfo; `frame` is the camera's, empty if none is known."""
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
    if abs(height_px - factor * model.height_px) > 1 or off_center(model) > MAX_OFF_CENTER:
        return None
    scale = np.array([factor, height_px / model.height_px])
    K = model.K.copy()
    K[:2] *= scale[:, None]
    K[:2, 2] += (scale - 1) / 2  # principal points count from the centre of the first pixel
    return CameraModel(model.frame_id, width_px, height_px, K, model.model, model.distortion)


def off_center(model: CameraModel) -> float:
    """Distance of the principal point from the middle of the image, as a share of its size."""
    center = (model.K[:2, 2] + 0.5) / [model.width_px, model.height_px]
    return float(np.abs(center - 0.5).max())


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
    if getattr(info, "width", None) == 0 and (size := recorded_size(topics, first)):
        info, remark = replace(info, width=size[0], height=size[1]), f"{source} has no image size: its images' is taken"
    if is_rectified(topics.image):
        model, T_model_camera = rectified_camera_model(info, frame_id=frame)
    elif reason := rectified_reason(info):
        model, T_model_camera = rectified_camera_model(info, frame_id=frame, is_turned=False)
        source = f"P of {source}"
        remark = "; ".join(filter(None, [remark, f"{source} is used, without distortion: {reason}"]))
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
