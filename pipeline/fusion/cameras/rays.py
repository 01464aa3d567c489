"""Directions from which the pixels of images are seen: the inverse of projection, lens distortion included."""

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.optics import lens_kernels
from pipeline.core.optics.lenses import Lenses

__all__ = ["rays_of_pixels"]

MAX_STEPS = 30
"""Steps of Newton's method; a dozen are enough at 85 degrees from the axis of a fisheye lens."""

NEAR_PX = 1e-4
"""A ray is found when it is projected this near to its pixel."""


def rays_of_pixels(lenses: Lenses, pixels: F64) -> tuple[F64, Bools]:
    """Rays that are projected to given pixels.

    By Newton's method from the ray of a lens without distortion. The lens bends a radius by a monotone function, so
    that it converges wherever the lens model has an image of a ray.

    Args:
        lenses: P cameras.
        pixels: (P, S, 2) of each camera; may lie outside its image.

    Returns:
        (P, S, 3) directions in the optical frames, of depth 1; and (P, S) whether there is such a ray. Where there is
        none, the direction is the optical axis.
    """
    return lens_kernels.rays_of_pixels(np.ascontiguousarray(pixels), *lenses.arrays, MAX_STEPS, NEAR_PX)
