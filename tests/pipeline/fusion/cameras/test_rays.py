from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from lens_models import LENS_MODELS, lens
from pipeline.fusion.cameras.rays import rays_of_pixels

from pipeline.core.arrays import F64
from pipeline.core.optics.lenses import Lenses


@pytest.mark.parametrize(("model", "distortion"), LENS_MODELS.values(), ids=LENS_MODELS)
@given(slopes=arrays(np.float64, (1, 9, 2), elements=st.floats(-0.6, 0.6)))
def test_rays_are_projected_to_their_pixels(model: Any, distortion: Any, slopes: F64) -> None:
    camera = Lenses.of([lens(model, distortion)])
    rays = np.concatenate([slopes, np.ones((1, 9, 1))], 2)
    pixels, valid = camera.project(rays)
    assert valid.all()
    found, is_found = rays_of_pixels(camera, pixels)
    assert is_found.all()
    np.testing.assert_allclose(found, rays, atol=2e-6)


@given(arrays(np.float64, (2, 8, 2), elements=st.floats(-2000, 2000)))
def test_without_distortion_rays_are_those_of_the_camera_matrix(pixels: F64) -> None:
    camera = Lenses.of([lens("plumb_bob", [])] * 2)
    K = camera.K[:, None]
    y = (pixels[..., 1] - 0.5 - K[..., 1, 2]) / K[..., 1, 1]
    x = (pixels[..., 0] - 0.5 - K[..., 0, 2] - K[..., 0, 1] * y) / K[..., 0, 0]
    found, is_found = rays_of_pixels(camera, pixels)
    assert is_found.all()
    np.testing.assert_array_equal(found, np.stack([x, y, np.ones(x.shape)], -1))


def test_fisheye_far_from_the_axis() -> None:
    camera = Lenses.of([lens("equidistant", [-0.01, 0.02, -0.005, 0.001])])
    tangents = np.tan(np.radians([0.0, 30.0, 60.0, 80.0, 86.0]))
    rays = np.stack([tangents, np.zeros(5), np.ones(5)], 1)[None]
    found, is_found = rays_of_pixels(camera, camera.project(rays)[0])
    assert is_found.all()
    np.testing.assert_allclose(found, rays, rtol=1e-4, atol=1e-6)


def test_pixels_without_a_ray_get_the_axis() -> None:
    # r (1 - 0.3 r^2) is at most 0.70: nothing is seen further than that from the principal point.
    camera = Lenses.of([lens("plumb_bob", [-0.3])])
    found, is_found = rays_of_pixels(camera, np.array([[[333.5, 251.5], [333.5 + 0.9 * 520, 251.5]]]))
    assert is_found.tolist() == [[True, False]]
    assert found[0, 1].tolist() == [0.0, 0.0, 1.0]


def test_cameras_row_by_row() -> None:
    models = [lens(*one) for one in LENS_MODELS.values()]
    pixels = np.full((len(models), 1, 2), 200.0)
    together, _ = rays_of_pixels(Lenses.of(models), pixels)
    alone = np.concatenate([rays_of_pixels(Lenses.of([one]), pixels[:1])[0] for one in models])
    np.testing.assert_allclose(together, alone, atol=1e-9)


def test_nothing() -> None:
    found, is_found = rays_of_pixels(Lenses.of([]), np.zeros((0, 8, 2)))
    assert found.shape == (0, 8, 3)
    assert is_found.shape == (0, 8)
