"""Rays of pixels, against Newton's method for all at once; points and their derivatives: test_lenses.py."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from lens_models import LENS_MODELS, lens

from pipeline.core.arrays import F64, Bools
from pipeline.core.optics.lens_kernels import rays_of_pixels
from pipeline.core.optics.lenses import Lenses

LENSES = Lenses.of([lens(*model) for model in LENS_MODELS.values()])


def judged_rays(lenses: Lenses, pixels: F64) -> tuple[F64, Bools]:
    """Newton's method for all pixels at once."""
    K = lenses.K[:, None]
    y = (pixels[..., 1] - 0.5 - K[..., 1, 2]) / K[..., 1, 1]
    x = (pixels[..., 0] - 0.5 - K[..., 0, 2] - K[..., 0, 1] * y) / K[..., 0, 0]
    rays = np.stack([x, y, np.ones(x.shape)], -1)
    for _ in range(30):
        shown, valid = lenses.project(rays)
        miss = pixels - shown
        found = valid & (np.abs(miss).max(-1) <= 1e-4)
        if (found | ~valid).all():
            break
        (a, b), (c, d) = np.moveaxis(lenses.jacobians(rays)[..., :2], (-2, -1), (0, 1))
        whole = np.where(a * d - b * c == 0, np.inf, a * d - b * c)
        step = np.stack([d * miss[..., 0] - b * miss[..., 1], a * miss[..., 1] - c * miss[..., 0]], -1)
        rays[..., :2] += np.where((valid & ~found)[..., None], step / whole[..., None], 0.0)
    return np.where(found[..., None], rays, [0.0, 0.0, 1.0]), found


@settings(max_examples=40)
@given(st.integers(0, 2**31))
def test_rays_are_those_of_newtons_method_for_all_at_once(seed: int) -> None:
    pixels = np.random.default_rng(seed).uniform(-400, 1000, (len(LENS_MODELS), 9, 2))
    found = rays_of_pixels(pixels, *LENSES.arrays, 30, 1e-4)
    for one, other in zip(found, judged_rays(LENSES, pixels), strict=True):
        np.testing.assert_array_equal(one, other)
