"""Rays of pixels; points and their derivatives: test_lenses.py."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from lens_models import LENS_MODELS, lens

from pipeline.core.optics.lens_kernels import rays_of_pixels
from pipeline.core.optics.lenses import Lenses

LENSES = Lenses.of([lens(*model) for model in LENS_MODELS.values()])


@settings(max_examples=40)
@given(st.integers(0, 2**31))
def test_rays_are_projected_to_their_pixels_and_those_of_points_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.4, -0.3, 1], [0.4, 0.3, 1], (len(LENS_MODELS), 9, 3))
    shown, is_shown = LENSES.project(points)
    rays, found = rays_of_pixels(shown, *LENSES.arrays, 30, 1e-6)
    assert (found == is_shown).all()
    np.testing.assert_allclose(rays[found], points[found], atol=1e-6)
    anywhere = rng.uniform(-400, 1000, (len(LENS_MODELS), 9, 2))
    rays, found = rays_of_pixels(anywhere, *LENSES.arrays, 30, 1e-4)
    pixels, valid = LENSES.project(rays)
    assert valid[found].all()
    np.testing.assert_allclose(pixels[found], anywhere[found], atol=2e-4)
    assert (rays[~found] == [0.0, 0.0, 1.0]).all()
