import re
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from builders import Fields, camera_info, raw

from lidcam.pipeline.core.errors import CalibrationError
from lidcam.readers.messages.camera_info import camera_model, rectified_camera_model, rectified_reason
from lidcam.readers.messages.deserialize import deserialize

K = np.array([[520.0, 0.0, 333.0], [0.0, 510.0, 251.0], [0.0, 0.0, 1.0]])
POINTS = np.array([[0.0, 0.0, 5.0], [1.0, 0.4, 4.0], [-1.5, -0.7, 6.0], [0.9, 0.9, 3.0]])


def info(encoding: Any = "cdr", /, *, more: Fields | None = None, **options: Any) -> Any:
    fields = {**camera_info(K, stamp_ns=1, width_px=640, height_px=480, **options), **(more or {})}
    return deserialize(raw("/camera_info", "sensor_msgs/msg/CameraInfo", fields, 1, encoding=encoding))


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_field_names_of_both_ros_versions(encoding: str) -> None:
    model = camera_model(info(encoding, distortion=(-0.3, 0.1, 0.001, -0.002, 0.01), frame_id="/cam"))
    np.testing.assert_array_equal(model.K, K)
    assert (model.frame_id, model.width_px, model.height_px, model.model) == ("cam", 640, 480, "plumb_bob")
    judge, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, model.distortion.copy())
    np.testing.assert_allclose(model.project(POINTS)[0] - 0.5, judge[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "coefficients", "expected"),
    [
        ("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0), "plumb_bob"),
        ("radtan", (-0.3, 0.1, 0.0, 0.0), "plumb_bob"),
        ("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "plumb_bob"),
        ("plumb_bob", (0.5, -2.6, 0.0, 0.0, 1.5, 0.4, -2.4, 1.4), "rational_polynomial"),
        ("rational_polynomial", (0.1, 0.2, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4), "rational_polynomial"),
        ("equidistant", (0.1, 0.01, 0.0, 0.0), "equidistant"),
        ("kannala_brandt", (0.1, 0.01, 0.0, 0.0), "equidistant"),
        ("kannala_brandt4", (0.1, 0.01, 0.0, 0.0), "equidistant"),
        ("", (), "plumb_bob"),
        ("brown_conrady", (0.0,) * 5, "plumb_bob"),
    ],
)
def test_distortion_models(name: str, coefficients: tuple[float, ...], expected: str) -> None:
    assert camera_model(info(distortion_model=name, distortion=coefficients)).model == expected


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"k": np.zeros(9)}, "uncalibrated"),
        ({"width": 0}, "0 x 480 px"),
        ({"k": np.diag([1e9, 1e9, 1]).reshape(9)}, "focal length"),
        ({"distortion_model": "omnidirectional", "d": np.array([1.0, 0.0])}, "'omnidirectional' with 2 coefficients"),
        ({"roi": {"x_offset": 600, "y_offset": 0, "width": 100, "height": 100}}, "does not lie in 640 x 480"),
    ],
)
def test_faults_are_named(change: Fields, reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        camera_model(info(more=change))


@pytest.mark.parametrize(
    "changed",
    [
        {"width": None},
        {"width": SimpleNamespace()},
        {"roi": SimpleNamespace(x_offset=0)},
        {"k": np.zeros(4)},
        {"k": ["a"] * 9},
        {"p": np.zeros(4)},
        {"distortion_model": 5},
    ],
)
def test_fields_of_another_definition(changed: Fields) -> None:
    """The definition in the recording need not be ROS's."""
    sound = info()
    known = {field.name: getattr(sound, field.name) for field in fields(sound)} | {**changed}
    other = SimpleNamespace(**{name: value for name, value in known.items() if value is not None})
    with pytest.raises(CalibrationError, match=r"CameraInfo has other fields than ROS's: "):
        rectified_camera_model(other) if "p" in changed else camera_model(other)


def test_region_of_interest_then_binning_as_image_geometry_does_it() -> None:
    more = {"binning_x": 2, "binning_y": 4, "roi": {"x_offset": 100, "y_offset": 40, "width": 400, "height": 320}}
    model = camera_model(info(more=more))
    assert (model.width_px, model.height_px) == (200, 80)
    # image_geometry::PinholeCameraModel::fromCameraInfo: the principal point moves by the offset, then all is scaled
    expected = np.array([[260.0, 0, (333 - 100) / 2], [0, 510 / 4, (251 - 40) / 4], [0, 0, 1]])
    np.testing.assert_allclose(model.K, expected)


def test_rectified_images_use_p_and_r_without_distortion() -> None:
    turn, _ = cv2.Rodrigues(np.array([0.02, -0.01, 0.03]))
    new_k = np.array([[480.0, 0, 310.0], [0, 480.0, 240.0], [0, 0, 1]])
    P = np.hstack([new_k, np.array([[-480.0 * 0.12], [0], [0]])])
    coefficients = (-0.2, 0.05, 0.001, 0.0, 0.0)
    message = info(distortion=coefficients, R=turn, P=P, frame_id="left")
    model, T_rectified_camera = rectified_camera_model(message)
    assert T_rectified_camera.dst == model.frame_id == "left_rectified"
    assert T_rectified_camera.src == "left"
    pixels, _ = model.project(T_rectified_camera.apply(POINTS))
    distorted, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, np.array(coefficients))
    judge = cv2.undistortPoints(distorted, K, np.array(coefficients), R=turn, P=new_k)
    np.testing.assert_allclose(pixels - 0.5, judge[:, 0], atol=0.01)  # OpenCV inverts the distortion by iteration
    model, T_rectified_camera = rectified_camera_model(info(frame_id="left"))  # without a turn
    assert (model.frame_id, T_rectified_camera.dst) == ("left", "left")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"P": np.zeros((3, 4))}, "P\\[0\\] is 0"),
        ({"R": np.zeros((3, 3))}, "R is not a rotation: it is singular"),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "reflection"),
    ],
)
def test_faults_of_rectified_images(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        rectified_camera_model(info(**options))


KITTI_K = [[959.8, 0, 696.0], [0, 956.9, 224.2], [0, 0, 1]]
KITTI_P = [[721.5, 0, 609.6, 44.9], [0, 721.5, 172.9, 0.2], [0, 0, 1, 0.003]]


@pytest.mark.parametrize(
    ("K", "P", "reason"),
    [
        (KITTI_K, KITTI_P, r"K is of an image of another size, with its centre at \(696, 224\)"),
        (np.zeros((3, 3)), KITTI_P, "K is 0"),
        (np.zeros((3, 3)), np.zeros((3, 4)), "^$"),
        (KITTI_K, np.zeros((3, 4)), "^$"),
        (KITTI_K, None, "^$"),  # its own: both are off
        ([[721.5, 0, 710], [0, 721.5, 172.9], [0, 0, 1]], KITTI_P, "^$"),  # a lens that sits askew
        ([[721.5, 0, 620], [0, 721.5, 167], [0, 0, 1]], [[700, 0, 620, 0], [0, 700, 170, 0], [0, 0, 1, 0]], "^$"),
    ],
)
def test_images_that_a_converter_rectified(K: Any, P: Any, reason: str) -> None:
    fields = camera_info(K, stamp_ns=1, width_px=1242, height_px=375, distortion=(-0.37, 0.2, 0, 0, 0), P=P)
    message = deserialize(raw("/camera_info", "sensor_msgs/msg/CameraInfo", fields, 1))
    assert re.search(reason, rectified_reason(message))


def test_the_frame_of_images_that_a_converter_rectified_is_not_turned() -> None:
    turn, _ = cv2.Rodrigues(np.array([0.0, 0.0, 0.015]))
    model, T_model_camera = rectified_camera_model(info(R=turn, P=KITTI_P, frame_id="left"), is_turned=False)
    assert (T_model_camera.dst, model.frame_id) == ("left", "left")
    in_pixels = POINTS @ np.array(KITTI_P)[:, :3].T
    np.testing.assert_allclose(model.project(POINTS)[0] - 0.5, in_pixels[:, :2] / in_pixels[:, 2:], atol=1e-9)
