import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS, lens

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.optics.lenses import Lenses

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
