from typing import Any

import numpy as np
import pytest
from detections import boxes2d, mounted
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS, lens
from seen_boxes import camera_at, views_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.optics.lenses import Lenses
from lidcam.pipeline.core.optics.upright import turned
from lidcam.pipeline.fusion.cameras.sightings import Noise, Observed, observe, see

CAMERA = camera_at("cam", (0.0, 0.0, 1.6))


def test_rays_point_to_the_outline_of_each_box_from_the_camera() -> None:
    camera = camera_at("tilted", (1.0, 2.0, 5.0), yaw_deg=20, pitch_deg=25, distortion=[-0.1, 0.05, 0.001, 0.002])
    found = see(views_of(camera), {"tilted": boxes2d([(300, 200, 500, 420, 0.9, 0)])})
    np.testing.assert_allclose(found.origin, [[1.0, 2.0, 5.0]], atol=1e-9)
    pixels, _ = camera.model.project(camera.T_camera_site.apply(found.origin[:, None] + 10 * found.rays))
    expected = [[300, 200], [400, 200], [500, 200], [500, 310], [500, 420], [400, 420], [300, 420], [300, 310]]
    np.testing.assert_allclose(pixels[0], expected, atol=1e-5)


def test_order_is_that_of_cameras_and_scores_and_not_that_of_the_boxes() -> None:
    rows = [(10, 10, 50, 90, 0.5, 1), (200, 10, 260, 90, 0.9, 0), (10, 10, 50, 90, 0.5, 0)]
    views = views_of(camera_at("b", (0.0, 0.0, 1.6)), camera_at("a", (0.0, 0.0, 1.6)), CAMERA)
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        found = see(views, {"a": boxes2d([rows[row] for row in order]), "b": boxes2d(rows[:1])})
        assert found.cameras.tolist() == [0, 1, 1, 1]
        assert found.scores.tolist() == np.array([0.5, 0.9, 0.5, 0.5], np.float32).tolist()
        assert found.class_ids.tolist() == [1, 0, 0, 1]
        assert [order[row] for row in found.rows[1:]] == [1, 2, 0]


def test_edges_at_the_border_are_cut_there() -> None:
    rows = [(-20, 100, 60, 800, 0.9, 0), (1200, 1.5, 1279, 90, 0.8, 0), (100, 100, 200, 200, 0.7, 0)]
    found = see(views_of(CAMERA), {"cam": boxes2d(rows)})
    assert found.cut.tolist() == [[True, False, False, True], [False, True, True, False], [False] * 4]
    assert found.xyxy[0].tolist() == [0, 100, 60, 720]


def test_boxes_that_show_nothing_are_left_out() -> None:
    rows = [(-50, 10, -5, 90, 0.9, 0), (50, 10, 50, 90, 0.8, 0), (np.nan, 10, 50, 90, 0.7, 0), (5, 5, 9, 9, 0.6, 0)]
    found = see(views_of(CAMERA), {"cam": boxes2d(rows)})
    assert found.rows.tolist() == [3]


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_camera_on_its_side_observes_what_an_upright_one_does(quarters: int) -> None:
    rows = np.array([(0, 300, 100, 420, 0.9, 0), (500, 330, 640, 470, 0.8, 0), (600, 340, 760, 520, 0.7, 0)])
    camera = mounted(CAMERA, quarters)
    size_px = np.tile([1280.0, 720.0], (len(rows), 1))
    shown = np.column_stack([turned(rows[:, :4], np.full(len(rows), 4 - quarters), size_px), rows[:, 4:]])
    expected, found = see(views_of(CAMERA), {"cam": boxes2d(rows)}), see(views_of(camera), {"cam": boxes2d(shown)})
    assert found.cut.tolist() == expected.cut.tolist()
    assert found.xyxy.tolist() == shown[:, :4].tolist()
    for one, other in zip(observe(found, NOISE), observe(expected, NOISE), strict=True):
        np.testing.assert_allclose(one, other, rtol=3e-3, atol=2e-3)


LEVEL = camera_at("level", (0.0, 0.0, 1.6))
NOISE = Noise(2.0, 0.0, 0.05, 0.01, 0.002)


def observed(*rows: tuple[float, ...], noise: Noise = NOISE) -> Observed:
    return observe(see(views_of(LEVEL), {"level": boxes2d(rows)}), noise)


def test_nothing_observed_is_known_of_a_cut_edge() -> None:
    found = observed((0, 300, 100, 720, 0.9, 0))
    assert (found.stds[0, [0, 3]] > 5 * np.array([found.width[0], found.upper[0] - found.lower[0]])).all()
    assert (found.stds[0, [1, 2]] < 0.1 * np.array([found.upper[0] - found.lower[0], found.width[0]])).all()


@pytest.mark.parametrize(
    ("front", "hidden"),
    [
        ((520, 460, 800, 600), [False, False, False, True]),  # below, over the whole width
        ((450, 320, 600, 600), [True, False, False, True]),
        ((650, 320, 900, 600), [False, False, True, True]),
        ((100, 320, 300, 600), [False] * 4),  # elsewhere
        ((520, 200, 800, 380), [False] * 4),  # further away
        ((450, 320, 580, 501), [False] * 4),  # as near
    ],
)
def test_edges_that_a_nearer_object_may_hide(front: tuple[float, ...], hidden: list[bool]) -> None:
    alone = observed((550, 300, 700, 500, 0.5, 0))
    found = observed((*front, 0.9, 0), (550, 300, 700, 500, 0.5, 0))
    assert (found.stds[1] > 3 * alone.stds[0]).tolist() == hidden
    if any(hidden):
        np.testing.assert_allclose(found.stds[0], observed((*front, 0.9, 0)).stds[0])


@pytest.mark.parametrize(("model", "distortion"), LENS_MODELS.values(), ids=LENS_MODELS)
@given(slopes=arrays(np.float64, (1, 9, 2), elements=st.floats(-0.6, 0.6)))
def test_rays_are_projected_to_their_pixels(model: Any, distortion: Any, slopes: F64) -> None:
    camera = Lenses.of([lens(model, distortion)])
    rays = np.concatenate([slopes, np.ones((1, 9, 1))], 2)
    pixels, valid = camera.project(rays)
    assert valid.all()
    found, is_found = camera.rays_of_pixels(pixels)
    assert is_found.all()
    np.testing.assert_allclose(found, rays, atol=2e-6)


def test_fisheye_far_from_the_axis() -> None:
    camera = Lenses.of([lens("equidistant", [-0.01, 0.02, -0.005, 0.001])])
    tangents = np.tan(np.radians([0.0, 30.0, 60.0, 80.0, 86.0]))
    rays = np.stack([tangents, np.zeros(5), np.ones(5)], 1)[None]
    found, is_found = camera.rays_of_pixels(camera.project(rays)[0])
    assert is_found.all()
    np.testing.assert_allclose(found, rays, rtol=1e-4, atol=1e-6)
