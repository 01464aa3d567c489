"""Points in images, their derivatives, and rays, for cameras with any lens: compiled, see `lens_formulas`."""

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.compiled import compiled
from pipeline.core.optics.lens_formulas import BLOCK, LENSES, lens_of, pixel_of, slopes_of

__all__ = ["pixels_of_points", "rays_of_pixels", "slopes_of_points"]


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({BLOCK}, {LENSES})")
def pixels_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """(P, S, 2) pixels of points (P, S, 3), and (P, S) whether they are valid; as `Lenses.project`.

    Args:
        points: Metres in the optical frames.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).
    """
    pixels, valid = np.empty((*points.shape[:2], 2)), np.empty(points.shape[:2], np.bool_)
    for p in range(points.shape[0]):
        lens = lens_of(K[p], coefficients[p], equidistant[p])
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            u, v, is_valid = pixel_of(x, y, z, lens, equidistant[p], limits[p])
            pixels[p, s, 0], pixels[p, s, 1], valid[p, s] = u, v, is_valid
    return pixels, valid


@compiled(f"float64[:, :, :, ::1]({BLOCK}, {LENSES})")
def slopes_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> F64:
    """(P, S, 2, 3) derivatives of the pixels of points; arguments as those of `pixels_of_points`."""
    slopes = np.empty((*points.shape[:2], 2, 3))
    for p in range(points.shape[0]):
        lens = lens_of(K[p], coefficients[p], equidistant[p])
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            found = slopes_of(x, y, z, lens, equidistant[p], limits[p])
            for k in range(3):
                slopes[p, s, 0, k], slopes[p, s, 1, k] = found[k], found[3 + k]
    return slopes


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({BLOCK}, {LENSES}, int64, float64)")
def rays_of_pixels(
    pixels: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64, max_steps: int, near_px: float
) -> tuple[F64, Bools]:
    """Rays that are projected to given pixels, by Newton's method from the ray of a lens without distortion.

    Args:
        pixels: (P, S, 2) of each camera.
        K: (P, 3, 3), and so on: the fields of `Lenses`.
        coefficients: (P, 8).
        equidistant: (P,).
        limits: (P,).
        max_steps: So many rays are tried for a pixel.
        near_px: A ray is found when it is projected this near to its pixel, across and down.

    Returns:
        (P, S, 3) directions in the optical frames, of depth 1; and (P, S) whether there is such a ray. Where there is
        none, the direction is the optical axis.
    """
    rays, found = np.zeros((*pixels.shape[:2], 3)), np.zeros(pixels.shape[:2], np.bool_)
    for p in range(pixels.shape[0]):
        lens = lens_of(K[p], coefficients[p], equidistant[p])
        fx, fy, cx, cy, skew = lens[:5]
        for s in range(pixels.shape[1]):
            y = (pixels[p, s, 1] - 0.5 - cy) / fy
            x = (pixels[p, s, 0] - 0.5 - cx - skew * y) / fx
            for _ in range(max_steps):
                u, v, valid = pixel_of(x, y, 1.0, lens, equidistant[p], limits[p])
                right, down = pixels[p, s, 0] - u, pixels[p, s, 1] - v
                found[p, s] = valid and abs(right) <= near_px and abs(down) <= near_px
                if found[p, s] or not valid:
                    break
                a, b, _, c, d, _ = slopes_of(x, y, 1.0, lens, equidistant[p], limits[p])
                determinant = a * d - b * c
                whole = np.inf if determinant == 0 else determinant
                x += (d * right - b * down) / whole
                y += (a * down - c * right) / whole
            rays[p, s, 2] = 1.0
            if found[p, s]:
                rays[p, s, 0], rays[p, s, 1] = x, y
    return rays, found
