import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS, lens
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64, Bools, Indices
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.optics.lenses import Lenses
from lidcam.pipeline.native.kernels import outermost_points

ALL = [lens(model, distortion) for model, distortion in LENS_MODELS.values()]
points = arrays(np.float64, (3, 3), elements=st.floats(-1, 1)).map(lambda p: p * [4, 3, 2] + [0, 0, 4])


@given(points)
def test_pixels_are_those_of_each_camera(table: F64) -> None:
    lenses = Lenses.of(ALL)
    pixels, valid = lenses.project(np.stack([table] * len(ALL)))
    for row, model in enumerate(ALL):
        expected, inside = model.project(table)
        np.testing.assert_array_equal(valid[row], inside)
        np.testing.assert_allclose(pixels[row][inside], expected[inside], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize(("name", "bends"), [(name, name != "none") for name in LENS_MODELS])
def test_which_lenses_bend_lines(name: str, bends: bool) -> None:
    lenses = Lenses.of([lens(*LENS_MODELS["none"]), lens(*LENS_MODELS[name])])
    assert lenses.bends is bends
    assert not lenses.select(np.array([0, 0])).bends


@pytest.mark.parametrize(("k1", "k2"), [(0.5, -0.2), (0.3, -0.25), (-0.25, 0.05)])
def test_rays_lead_to_pixels_up_to_the_edge_of_the_lens_model(k1: float, k2: float) -> None:
    model = CameraModel(
        "c", 1280, 960, np.array([[400.0, 0, 640], [0, 400, 480], [0, 0, 1]]), "plumb_bob", np.array([k1, k2, 0, 0])
    )
    radii, angles = np.linspace(0, 0.97 * min(model.radius_limit, 1.5), 200), np.linspace(0, 2 * np.pi, 37)
    flat = np.stack([np.outer(radii, np.cos(angles)), np.outer(radii, np.sin(angles))], -1).reshape(-1, 2)
    pixels, valid = model.project(np.column_stack([flat, np.ones(len(flat))]))
    assert valid.all()
    rays, found = Lenses.of([model]).rays_of_pixels(pixels[None])
    assert found.mean() > 0.99
    np.testing.assert_allclose(rays[0, found[0], :2], flat[found[0]], atol=1e-3)


def test_no_cameras() -> None:
    lenses = Lenses.of([])
    pixels, valid = lenses.project(np.zeros((0, 8, 3)))
    assert (pixels.shape, valid.shape) == ((0, 8, 2), (0, 8))
    assert not lenses.bends


MODELS = [lens(*model) for model in LENS_MODELS.values()]
LENSES = Lenses.of(MODELS)
STEP = 1e-6


def made_up(seed: int, count: int = 7) -> tuple[F64, Indices, F64, F64, F64, F64]:
    """Boxes (x, y, yaw, length, width, height, z), their cameras, outlines, and how the cameras stand."""
    random = np.random.default_rng(seed)
    boxes = random.uniform([-3, -2, -3, 0.5, 0.4, 0.3, 4], [3, 2, 3, 4, 3, 2, 12], (count, 7))
    rows = random.integers(len(MODELS), size=count)
    signs, offsets = random.uniform(-1, 1, (9, 3)), random.uniform(-0.1, 0.1, (len(MODELS), 9, 3))
    turns = Rotation.from_rotvec(random.normal(0, 0.1, (len(MODELS), 3))).as_matrix()
    return boxes, rows, signs, offsets, turns, random.normal(0, 0.2, (len(MODELS), 3))


def outermost(
    boxes: F64, rows: Indices, signs: F64, offsets: F64, turns: F64, moves: F64
) -> tuple[F64, F64, Indices, Bools]:
    x, y, yaws, length, width, height, z = boxes.T
    place = np.column_stack([x, y, z]), np.column_stack([length, width, height]), np.cos(yaws), np.sin(yaws)
    return outermost_points(*place, rows, signs, offsets, turns, moves, *LENSES.arrays)


def points_in_camera(box: F64, signs: F64, offsets: F64, turn: F64, move: F64) -> F64:
    x, y, yaw, *size, z = box
    along = signs * size / 2 + offsets
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.asarray((along @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + [x, y, z]) @ turn.T + move)


@given(st.integers(0, 2**31))
def test_edges_are_those_around_all_points(seed: int) -> None:
    boxes, rows, signs, offsets, turns, moves = made_up(seed)
    edges, _, makers, valid = outermost(boxes, rows, signs, offsets, turns, moves)
    for q, (box, row) in enumerate(zip(boxes, rows, strict=True)):
        model: CameraModel = MODELS[row]
        pixels, is_valid = model.project(points_in_camera(box, signs, offsets[row], turns[row], moves[row]))
        assert valid[q] == is_valid.all()
        if valid[q]:
            np.testing.assert_allclose(edges[q], [*pixels.min(0), *pixels.max(0)], rtol=1e-11, atol=1e-9)
            assert makers[q].tolist() == [*pixels.argmin(0), *pixels.argmax(0)]


@settings(max_examples=30)
@given(st.integers(0, 2**31))
def test_derivatives_are_the_slopes_of_the_edges(seed: int) -> None:
    boxes, rows, *rest = made_up(seed, count=1)
    edges, slopes, makers, valid = outermost(boxes, rows, *rest)
    rows = np.repeat(rows, 7)
    above, below = outermost(boxes + STEP * np.eye(7), rows, *rest), outermost(boxes - STEP * np.eye(7), rows, *rest)
    assume(valid.all() and above[3].all() and below[3].all())
    assume((above[2] == makers).all() and (below[2] == makers).all())
    expected = ((above[0] - below[0]) / (2 * STEP)).T
    np.testing.assert_allclose(slopes[0], expected, atol=1e-6 * np.abs(edges).max() + 1e-5 * np.abs(slopes).max())


@pytest.mark.parametrize("shared", [True, False])
def test_one_outline_for_all(shared: bool) -> None:
    boxes, rows, signs, offsets, *stands = made_up(1)
    own = offsets[:1] if shared else np.broadcast_to(offsets[:1], offsets.shape).copy()
    expected = outermost(boxes, rows, signs, np.tile(offsets[:1], (len(MODELS), 1, 1)), *stands)
    for found, same in zip(outermost(boxes, rows, signs, own, *stands), expected, strict=True):
        np.testing.assert_array_equal(found, same)


@given(st.integers(0, 2**31))
def test_rectangles_of_boxes_are_those_of_each_camera(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = len(MODELS)
    centers, sizes = random.uniform([-4, -3, -3], [4, 3, 6], (count, 3)), random.uniform(0.3, 8, (count, 3))
    corners = box_corners(centers, sizes, random.uniform(-3, 3, count))
    image_sizes = np.array([[model.width_px, model.height_px] for model in MODELS], np.float64)
    found = LENSES.rectangles_of_boxes(corners, image_sizes)
    for model, corner, rectangle in zip(MODELS, corners, found, strict=True):
        np.testing.assert_allclose(rectangle, model.project_boxes(corner[None])[0], rtol=1e-6, atol=1e-4)
