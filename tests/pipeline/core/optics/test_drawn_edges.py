from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lens_models import LENS_MODELS, lens

from lidcam.pipeline.core.arrays import F32, F64, Indices
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.geometry.box_edges import BOX_EDGES
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.optics.drawn_edges import draw_edges

UNFOLDED = {name: model for name, model in LENS_MODELS.items() if name != "plumb_bob_folding"}
"""Where a lens folds in the image, the edge ends up to a sample before that."""


def drawn(model: CameraModel, corners: F64) -> tuple[F32, Indices]:
    """Pieces and rows of boxes in the image of one camera."""
    return draw_edges([model], corners, np.zeros(len(corners), np.intp))


def from_pieces(points: F64, pieces: F64) -> F64:
    """(P,) distance of each point (P, 2) from the nearest of straight pieces (M, 2, 2)."""
    start, way = pieces[:, 0], pieces[:, 1] - pieces[:, 0]
    share = ((points[:, None] - start) * way).sum(-1) / np.maximum((way**2).sum(-1), 1e-9)
    nearest = start + np.clip(share, 0, 1)[..., None] * way
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1).min(1))


@pytest.mark.parametrize(("model", "distortion"), UNFOLDED.values(), ids=UNFOLDED)
@given(st.floats(-6, 6), st.floats(-3, 3), st.floats(1, 20), st.floats(-np.pi, np.pi))
def test_edges_lie_where_the_lens_shows_them(
    model: Any, distortion: list[float], x: float, y: float, z: float, yaw: float
) -> None:
    shown_by = lens(model, distortion)
    corners = box_corners(np.array([[x, y, z]]), np.array([[4.0, 1.8, 1.5]]), np.array([yaw]))
    pieces, rows = drawn(shown_by, corners)
    assert pieces.dtype == np.float32
    assert len(pieces) == len(rows)
    assert ((pieces >= 0) & (pieces <= [640, 480])).all()
    shares = np.linspace(0, 1, 40)[:, None]
    points = np.concatenate([corners[0, a] * (1 - shares) + corners[0, b] * shares for a, b in BOX_EDGES.tolist()])
    pixels, valid = shown_by.project(points)
    shown = valid & (pixels > 1).all(1) & (pixels < [639, 479]).all(1) & (points[:, 2] > 0.05)
    if shown.any():
        assert from_pieces(pixels[shown], pieces.astype(np.float64)).max() < 2.0


@pytest.mark.parametrize(("model", "distortion"), LENS_MODELS.values(), ids=LENS_MODELS)
def test_edges_reach_as_far_as_the_upright_rectangle(model: Any, distortion: list[float]) -> None:
    shown_by = lens(model, distortion)
    centers = np.array([[-1.0, 0.2, 6], [0.5, -0.5, 9], [0, 0, -5], [1.5, 0.5, 4]])
    corners = box_corners(centers, np.tile([2.0, 1.0, 0.8], (4, 1)), np.array([0.3, 1, 0, -2]))
    pieces, rows = drawn(shown_by, corners)
    assert sorted(set(rows.tolist())) == [0, 1, 3]  # the third lies behind
    for row in (0, 1, 3):
        points = pieces[rows == row].reshape(-1, 2)
        found = np.concatenate([points.min(0), points.max(0)])
        np.testing.assert_allclose(found, shown_by.project_boxes(corners)[row], atol=0.6)


@pytest.mark.parametrize("counts", [(3, 0, 2), (0, 0, 0), (0, 4, 1)])
def test_several_cameras_at_once_are_as_one_after_another(counts: tuple[int, ...]) -> None:
    rng = np.random.default_rng(sum(counts))
    lenses = [lens("plumb_bob", []), lens("plumb_bob", [-0.3]), lens("equidistant", [0.1])]
    n, cameras = sum(counts), np.repeat(np.arange(3), counts)
    corners = box_corners(rng.normal(size=(n, 3)) * 3 + [0, 0, 4], rng.uniform(1, 3, (n, 3)), rng.normal(size=n))
    pieces, rows = draw_edges(lenses, corners, cameras)
    for camera, model in enumerate(lenses):
        alone, alone_rows = drawn(model, corners[cameras == camera])
        np.testing.assert_array_equal(pieces[cameras[rows] == camera], alone)
        np.testing.assert_array_equal(rows[cameras[rows] == camera], np.flatnonzero(cameras == camera)[alone_rows])


def test_straight_edges_are_one_piece_each() -> None:
    corners = box_corners(np.array([[0.0, 0, 8]]), np.array([[2.0, 2, 2]]), np.zeros(1))
    assert len(drawn(lens("plumb_bob", []), corners)[0]) == 12
    assert len(drawn(lens("plumb_bob", [-0.3]), corners * [1, 1, 0.3])[0]) > 24
    assert len(drawn(lens("plumb_bob", []), np.zeros((0, 8, 3)))[0]) == 0
