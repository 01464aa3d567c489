from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.boxes import box_corners

K = np.array([[520.0, 0.0, 333.0], [0.0, 510.0, 251.0], [0.0, 0.0, 1.0]])
OPTICAL = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # site axes (x forward, z up) to optical ones
NAMES = ["none", "plumb_bob_4", "plumb_bob_5", "rational", "equidistant"]


def camera(model: Any = "plumb_bob", distortion: Any = (), **changes: Any) -> CameraModel:
    fields = {"frame_id": "cam", "width_px": 640, "height_px": 480, "K": K.copy(), "model": model}
    return CameraModel(**{**fields, "distortion": np.array(distortion, np.float64), **changes})


LENSES = [camera(*LENS_MODELS[name]) for name in NAMES]
lenses = pytest.mark.parametrize("lens", LENSES, ids=NAMES)


def opencv(points: F64, lens: CameraModel) -> F64:
    """Pixels counted from the centre of the top left pixel."""
    zero = np.zeros(3)
    if lens.model == "equidistant":
        return np.asarray(cv2.fisheye.projectPoints(points[:, None], zero, zero, K, lens.distortion)[0][:, 0])
    return np.asarray(cv2.projectPoints(points, zero, zero, K, lens.distortion)[0][:, 0])


# --- points


@lenses
@given(points=arrays(np.float64, (6, 3), elements=st.floats(-0.6, 0.6)))
def test_projection_is_opencvs_plus_half_a_pixel(lens: CameraModel, points: F64) -> None:
    points = points * [4, 3, 1] + [0, 0, 6]
    pixels, valid = lens.project(points)
    assert valid.all()
    np.testing.assert_allclose(pixels - 0.5, opencv(points, lens), atol=1e-6)


def test_the_optical_axis_meets_the_principal_point_from_the_pixels_corner() -> None:
    # cx = 333 is the centre of column 333, which reaches from 333 to 334
    np.testing.assert_allclose(camera().project(np.array([0.0, 0, 3]))[0], [333.5, 251.5])


@lenses
@pytest.mark.parametrize("point", [[0, 0, 0], [1, 1, 0], [0, 0, -3], [1, 1, 1e-300]])
def test_points_behind_or_at_the_camera_are_not_in_view(lens: CameraModel, point: list[float]) -> None:
    pixels, valid = lens.project(np.array(point, np.float64))
    assert not valid
    assert np.isfinite(pixels).all()


@pytest.mark.parametrize(
    ("model", "distortion", "tangent_of_fold"),
    [
        ("plumb_bob", [-0.3], np.sqrt(1 / 0.9)),  # r (1 - 0.3 r^2) turns where 1 = 0.9 r^2
        ("plumb_bob", [0.1, -0.05], np.sqrt((0.3 + np.sqrt(0.09 + 1)) / 0.5)),  # 1 + 0.3 s - 0.25 s^2 = 0
        ("equidistant", [-0.2], np.tan(np.sqrt(1 / 0.6))),
    ],
)
def test_where_the_lens_model_folds_back_points_are_not_in_view(
    model: Any, distortion: list[float], tangent_of_fold: float
) -> None:
    lens = camera(model, distortion)
    tangents = np.array([0.5, 0.98, 1.02, 1.5, 3.0]) * tangent_of_fold
    _, valid = lens.project(np.stack([tangents, np.zeros(5), np.ones(5)], 1))
    assert valid.tolist() == [True, True, False, False, False]


def test_skew_is_part_of_k() -> None:
    skewed = K.copy()
    skewed[0, 1] = 7.0
    np.testing.assert_allclose(camera(K=skewed).project(np.array([0, 1.0, 2]))[0], [333.5 + 3.5, 251.5 + 255])


# --- boxes


def dense_bounds(lens: CameraModel, corners: F64, *, steps: int = 60) -> F64 | None:
    """Rectangle around what the image shows of one box, from points all over its faces."""
    share = np.linspace(0, 1, steps)
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(share, share))
    origin, axes = corners[0], [corners[1] - corners[0], corners[3] - corners[0], corners[4] - corners[0]]
    faces = [
        origin + side * axes[k] + u * axes[(k + 1) % 3] + v * axes[(k + 2) % 3] for k in range(3) for side in (0.0, 1.0)
    ]
    pixels, valid = lens.project(np.concatenate(faces))
    shown = pixels[valid & (pixels >= 0).all(1) & (pixels <= [lens.width_px, lens.height_px]).all(1)]
    return np.array([*shown.min(0), *shown.max(0)]) if len(shown) else None


def boxes(rng: np.random.Generator, n: int, *, nearest_m: float) -> F64:
    centers = np.c_[rng.uniform(nearest_m, 25, n), rng.uniform(-14, 14, n), rng.uniform(-2, 1, n)]
    sizes = np.c_[rng.uniform(0.5, 5, n), rng.uniform(0.5, 2.5, n), rng.uniform(0.5, 3, n)]
    return np.asarray(box_corners(centers, sizes, rng.uniform(-3, 3, n)) @ OPTICAL.T)


@lenses
def test_rectangles_hold_what_the_image_shows_and_no_more(lens: CameraModel) -> None:
    corners = boxes(np.random.default_rng(3), 80, nearest_m=4.0)
    judged = [dense_bounds(lens, box) for box in corners]
    shown = [row for row, bounds in enumerate(judged) if bounds is not None]
    assert 50 < len(shown) < 78
    slack = (lens.project_boxes(corners)[shown] - [judged[row] for row in shown]) * [1, 1, -1, -1]
    assert ((slack > -4.0) & (slack <= 1.0)).all()  # the judge has points 1.6 % of a side apart


def test_a_box_that_leaves_the_image_is_clipped_to_it() -> None:
    corners = box_corners(np.array([[10.0, 5, 0]]), np.array([[2.0, 4, 2]]), np.zeros(1)) @ OPTICAL.T
    expected = [0, 251.5 - 510 / 9, 333.5 - 520 * 3 / 11, 251.5 + 510 / 9]  # its left part is out of view
    np.testing.assert_allclose(camera().project_boxes(corners)[0], expected, atol=1e-3)


def test_a_box_around_the_camera_fills_the_image() -> None:
    corners = box_corners(np.zeros((1, 3)), np.array([[4.0, 4, 4]]), np.zeros(1)) @ OPTICAL.T
    np.testing.assert_allclose(camera().project_boxes(corners)[0], [0, 0, 640, 480])


def test_a_box_that_reaches_behind_the_camera_is_cut_at_its_plane() -> None:
    # a lorry beside us, 2 m to the right, from 5 m behind to 10 m ahead: only its front edge is inside the image
    corners = box_corners(np.array([[2.5, -3.0, 0]]), np.array([[15.0, 2, 2]]), np.zeros(1)) @ OPTICAL.T
    half_height = 510 * (640 - 333.5) / (520 * 2)  # at the border of the image
    expected = [333.5 + 520 * 2 / 10, 251.5 - half_height, 640, 251.5 + half_height]
    np.testing.assert_allclose(camera().project_boxes(corners)[0], expected, atol=1e-3)


@pytest.mark.parametrize(
    "center", [[-10.0, 0, 0], [10.0, 30, 0], [10.0, 0, 30], [10.0, 0, -30], [-0.5, 0, 0]], ids=["behind", *"luda"]
)
@lenses
def test_boxes_out_of_view_are_nan(center: list[float], lens: CameraModel) -> None:
    corners = box_corners(np.array([center]), np.array([[0.9, 0.9, 0.9]]), np.zeros(1)) @ OPTICAL.T
    assert np.isnan(lens.project_boxes(corners)).all()


def test_no_boxes() -> None:
    found = camera().project_boxes(np.zeros((0, 8, 3)))
    assert (found.shape, found.dtype) == ((0, 4), np.dtype(np.float32))


# --- faults


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"model": "fisheye62"}, "'fisheye62' is not one of plumb_bob"),
        ({"K": np.eye(4)}, "nine finite numbers"),
        ({"K": K * np.nan}, "nine finite numbers"),
        ({"K": K.T.copy()}, "below the diagonal"),
        ({"K": 2 * K}, "below the diagonal"),
        ({"width_px": 0}, "image size 0 x 480"),
        ({"height_px": -1}, "image size 640 x -1"),
        ({"K": np.diag([0.0, 500, 1])}, "focal length 0, 500 px is impossible"),
        ({"K": np.diag([500.0, 1e7, 1])}, "focal length"),
        ({"distortion": np.array([np.inf])}, "finite"),
        ({"distortion": np.ones(6)}, "plumb_bob has 5 coefficients, found 6"),
        ({"model": "equidistant", "distortion": np.ones(5)}, "equidistant has 4 coefficients, found 5"),
    ],
)
def test_impossible_intrinsics_are_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        camera(**change)


@lenses
@pytest.mark.parametrize("focal_px", [150.0, 400.0, 1500.0])
def test_all_that_an_image_shows_lies_in_the_cone_of_its_view(lens: CameraModel, focal_px: float) -> None:
    model = replace(lens, K=np.array([[focal_px, 3.0, 300.0], [0, focal_px * 1.1, 260.0], [0, 0, 1]]))
    angles = np.stack(np.meshgrid(np.linspace(0, 1.5, 150), np.linspace(-np.pi, np.pi, 60)), -1).reshape(-1, 2)
    aside, around = angles.T
    rays = np.stack([np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), np.cos(aside)], 1)
    pixels, valid = model.project(rays)
    shown = valid & (pixels >= 0).all(1) & (pixels <= [640, 480]).all(1)
    assert aside[shown].max() <= model.view_angle_rad
    assert min(model.view_angle_rad, 1.5) <= aside[shown].max() * 1.35 + 0.02, "and not much else"
