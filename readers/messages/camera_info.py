"""Converts sensor_msgs/CameraInfo to `CameraModel`.

Sources: the comments of sensor_msgs/CameraInfo.msg and REP 104; image_geometry's PinholeCameraModel for region of
interest and binning. K and D describe a raw image. P = K' [I | t] describes a rectified one (`image_rect`,
`image_rect_color`), in a frame rotated by R: x_rectified = R x_camera. The last column of P is not used: it is the
baseline of a stereo pair, which the extrinsics already contain.

Converters of data sets write rectified images under a raw topic's name, with the K and D of the camera that they were
rectified from (kitti2bag: of 1392 x 512 pixels, for images of 1242 x 375), or with no K at all. Then P alone is the
calibration of the images.

A field that is missing and a value that is not valid raise a `CalibrationError`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel, DistortionModel
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform, rotation_fault
from lidcam.pipeline.core.text import one_line
from lidcam.readers.messages.tf import clean_frame

DISTORTION_MODELS: dict[str, DistortionModel] = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "kannala_brandt": "equidistant",
    "kannala_brandt4": "equidistant",
    "fisheye": "equidistant",
}
"""Model by its name in recordings."""

MAX_OFF_CENTER = 0.05
"""Largest distance of a principal point from the middle of the image, as a share of its size, that raises no doubt."""


def distortion_model(name: str, coefficients: npt.ArrayLike) -> tuple[DistortionModel, F64]:
    """A distortion model by its ROS name, and its coefficients as float64.

    An unknown model whose coefficients are all zero means no distortion. A `plumb_bob` with more than five is the
    rational polynomial, as OpenCV counts: Orbbec's driver names them so.

    Raises:
        CalibrationError: the model is unknown and a coefficient is not zero.
    """
    values = np.array(coefficients, np.float64).reshape(-1)
    known = DISTORTION_MODELS.get(name.strip().lower())
    if known == "plumb_bob" and values[5:].any():
        known = "rational_polynomial"
    if known is not None:
        return known, values
    if not values.any():
        return "plumb_bob", np.zeros(0)
    raise CalibrationError(
        f"distortion model {name!r} with {len(values)} coefficients: expected one of {', '.join(DISTORTION_MODELS)}"
    )


@contextmanager
def _other_fields_told() -> Iterator[None]:
    """Turn what fields of another definition raise into a `CalibrationError`."""
    try:
        yield
    except (ArithmeticError, AttributeError, TypeError, ValueError) as err:
        reason = one_line(err, max_characters=200)
        raise CalibrationError(f"CameraInfo has other fields than ROS's: {type(err).__name__}: {reason}") from err


@_other_fields_told()
def camera_model(info: Any, *, frame_id: str = "") -> CameraModel:
    """Intrinsics of the raw image: K and the lens distortion, for the part of the sensor that was read out."""
    model, coefficients = distortion_model(info.distortion_model, _field(info, "d"))
    K = _field(info, "k").reshape(3, 3)
    if K[0, 0] == 0:
        raise CalibrationError("CameraInfo.K[0] is 0: the camera is uncalibrated; give its calibration in a rig file")
    return _of_read_out(info, frame_id or clean_frame(info.header.frame_id), K, model, coefficients)


@_other_fields_told()
def rectified_reason(info: Any) -> str:
    """Why P without distortion is the calibration of images that are not called rectified; empty if it is not."""
    K, P = _field(info, "k").reshape(3, 3), _field(info, "p").reshape(3, 4)
    if P[0, 0] <= 0:
        return ""
    if K[0, 0] == 0:
        return "its K is 0"
    size = np.array([int(info.width), int(info.height)], np.float64)
    off, off_P = ((one[:2, 2] + 0.5) / np.maximum(size, 1) - 0.5 for one in (K, P))
    is_of_other_size = np.abs(off).min() > MAX_OFF_CENTER and off.prod() > 0  # lenses are off centre in one direction
    if is_of_other_size and np.abs(off_P).max() <= MAX_OFF_CENTER:
        return f"its K is of an image of another size, with its centre at ({K[0, 2]:.0f}, {K[1, 2]:.0f})"
    return ""


@_other_fields_told()
def rectified_camera_model(info: Any, *, frame_id: str = "", is_turned: bool = True) -> tuple[CameraModel, Transform]:
    """Intrinsics of the rectified image, and the rotation of its frame.

    `frame_id` is that of the camera, else the message says it. `is_turned`: it is that of the raw image; otherwise it
    is the rectified one, and R is not used.

    Returns:
        The model (K = P[:, :3], no distortion) and T_rectified_camera. The rectified frame is `<frame>_rectified`, or
        the camera's frame if R is the identity.
    """
    K = _field(info, "p").reshape(3, 4)[:, :3].copy()
    if K[0, 0] == 0:
        raise CalibrationError("CameraInfo.P[0] is 0, but its images are rectified; give its calibration in a rig file")
    rotation = _field(info, "r").reshape(3, 3) if is_turned else np.eye(3)
    if fault := rotation_fault(rotation):
        raise CalibrationError(f"CameraInfo.R is not a rotation: {fault}")
    frame = frame_id or clean_frame(info.header.frame_id)
    turned = not np.array_equal(rotation, np.eye(3))
    model = _of_read_out(info, f"{frame}_rectified" if turned else frame, K, "plumb_bob", np.zeros(0))
    return model, Transform(model.frame_id, frame, pose_matrix(rotation))


def other_camera_model(info: Any, raw: CameraModel) -> tuple[CameraModel, Transform] | None:
    """`rectified_camera_model`, where it differs from the model of the raw image: images may be rectified unsaid.

    None if it is the same, or if P or R is of no use.
    """
    try:
        model, T_rectified_camera = rectified_camera_model(info, frame_id=raw.frame_id)
    except CalibrationError:
        return None
    is_same = not raw.distortion.any() and np.allclose(model.K, raw.K) and model.frame_id == raw.frame_id
    return None if is_same else (model, T_rectified_camera)


def _of_read_out(info: Any, frame: str, K: F64, model: DistortionModel, coefficients: F64) -> CameraModel:
    """The model after region of interest, then binning: K and size are given for the full sensor."""
    width, height, roi = int(info.width), int(info.height), info.roi
    if width <= 0 or height <= 0:
        raise CalibrationError(f"CameraInfo says an image of {width} x {height} px: expected positive numbers")
    x, y = int(roi.x_offset), int(roi.y_offset)
    part_width, part_height = int(roi.width) or width - x, int(roi.height) or height - y
    if x + part_width > width or y + part_height > height or part_width <= 0 or part_height <= 0:
        raise CalibrationError(
            f"CameraInfo.roi of {part_width} x {part_height} px at ({x}, {y}) does not lie in {width} x {height} px"
        )
    bin_x, bin_y = max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    shift = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
    with np.errstate(over="ignore", invalid="ignore"):  # the model refuses what is not finite
        scaled = np.diag([1 / bin_x, 1 / bin_y, 1.0]) @ shift @ K
    return CameraModel(frame, part_width // bin_x, part_height // bin_y, scaled, model, coefficients)


def _field(info: Any, name: str) -> F64:
    value = getattr(info, name.upper(), None)
    return np.array(getattr(info, name) if value is None else value, np.float64)
