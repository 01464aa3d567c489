"""The lens models of `core.camera` for many cameras at once, compiled: points in images, their derivatives, and rays.

Each row of points is projected by a camera of its own, so that boxes seen by several cameras are one computation.

For a point at (x, y) = (X / Z, Y / Z) with r2 = x x + y y, a lens of `rational_polynomial` (of which `plumb_bob` and
lenses without distortion are cases) shows it at

    x scale(r2) + 2 p1 x y + p2 (r2 + 2 x x),   y scale(r2) + p1 (r2 + 2 y y) + 2 p2 x y

and an `equidistant` one at (x, y) scale(r2), where the scale turns the tangent of the angle to the axis into a
polynomial of the angle. Derivatives follow from that of the scale by r2.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, CheckedTable
from lidcam.pipeline.core.camera import EDGE_SHARES, NEAR_M, CameraModel
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.core.geometry.box_edges import edges_ahead

LIST = "Array(float64, 1, 'C', True)"
TABLE = "Array(float64, 2, 'C', True)"
BLOCK = "Array(float64, 3, 'C', True)"
"""Types of arrays with one, two and three dimensions, perhaps read-only."""

LENSES = f"{BLOCK}, {TABLE}, Array(boolean, 1, 'C', True), {LIST}"
"""Types of the fields of `Lenses`."""

_NEAR_M = 0.005
"""Least depth of a point in the image: half of `core.camera.NEAR_M`."""

MAX_STEPS = 30
"""Steps of Newton's method; a dozen are enough at 85 degrees from the axis of a fisheye lens."""

NEAR_PX = 1e-4
"""A ray is found when it is projected this near to its pixel, across and down."""

_ON_AXIS = 1e-4
"""Below this radius the quotients of the equidistant model lose their digits: the series about the axis stands in."""


@inlined
def _within(r2: float, equidistant: bool, limit: float) -> bool:
    """Whether a point is where the lens model is one-to-one."""
    return math.atan(math.sqrt(r2)) < limit if equidistant else r2 < limit * limit


@inlined
def lens_of(K: F64, k: F64, equidistant: bool) -> tuple[float, ...]:
    """Focal lengths, centre and skew of a camera, its tangential and its radial coefficients: quicker than arrays."""
    p1, p2 = (0.0, 0.0) if equidistant else (k[2], k[3])
    third, fourth = (k[2], k[3]) if equidistant else (k[4], 0.0)
    return K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1], p1, p2, k[0], k[1], third, fourth, k[5], k[6], k[7]


@inlined
def _scale(r2: float, lens: tuple[float, ...], equidistant: bool) -> float:
    """The radial scale at a squared radius."""
    k1, k2, k3, k4, k5, k6, k7 = lens[7:]
    if equidistant:
        radius = math.sqrt(r2)
        theta = math.atan(radius)
        t2 = theta * theta
        grown = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return grown / radius if radius >= _ON_AXIS else 1 + (k1 - 1 / 3) * r2
    return (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)))


@inlined
def _scale_slope(r2: float, scale: float, lens: tuple[float, ...], equidistant: bool) -> float:
    """The derivative of the radial scale by the squared radius."""
    k1, k2, k3, k4, k5, k6, k7 = lens[7:]
    if equidistant:
        theta = math.atan(math.sqrt(r2))
        t2 = theta * theta
        growth = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        return (growth / (1 + r2) - scale) / (2 * r2) if math.sqrt(r2) >= _ON_AXIS else k1 - 1 / 3
    top_slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    bottom_slope = k5 + r2 * (2 * k6 + 3 * r2 * k7)
    return (top_slope - scale * bottom_slope) / (1 + r2 * (k5 + r2 * (k6 + r2 * k7)))


@inlined
def pixel_of(
    x: float, y: float, z: float, lens: tuple[float, ...], equidistant: bool, limit: float
) -> tuple[float, float, bool]:
    """The pixel u, v of a point in the optical frame, and whether it is ahead and within the lens model."""
    fx, fy, cx, cy, skew, p1, p2 = lens[:7]
    ahead = z > _NEAR_M
    depth = z if ahead else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    inside = _within(r2, equidistant, limit)
    r2 = r2 if inside else 0.0
    scale = _scale(r2, lens, equidistant)
    x_lens = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_lens = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return fx * x_lens + skew * y_lens + cx + 0.5, fy * y_lens + cy + 0.5, ahead and inside


@inlined
def slopes_of(
    x: float, y: float, z: float, lens: tuple[float, ...], equidistant: bool, limit: float
) -> tuple[float, float, float, float, float, float]:
    """Derivatives of u by x, y, z, and then those of v."""
    fx, fy, _, _, skew, p1, p2 = lens[:7]
    depth = z if z > _NEAR_M else 1.0
    x, y = x / depth, y / depth
    r2 = x * x + y * y
    r2 = r2 if _within(r2, equidistant, limit) else 0.0
    scale = _scale(r2, lens, equidistant)
    slope = _scale_slope(r2, scale, lens, equidistant)
    xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # x by y, and y by x
    yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    u_by_x, u_by_y = (fx * xx + skew * xy) / depth, (fx * xy + skew * yy) / depth
    v_by_x, v_by_y = fy * xy / depth, fy * yy / depth
    return u_by_x, u_by_y, -u_by_x * x - u_by_y * y, v_by_x, v_by_y, -v_by_x * x - v_by_y * y


@dataclass(frozen=True, eq=False)
class Lenses(CheckedTable):
    """Intrinsics of P cameras, row by row."""

    ROWS: ClassVar = {"K": (3, 3), "coefficients": (8,)}

    K: F64  # (P, 3, 3) float64 camera matrices, pixels
    coefficients: F64  # (P, 8) float64 distortion, in the order of its model; missing ones are zero
    equidistant: Bools  # (P,) whether the model is `equidistant`; the others are cases of `rational_polynomial`
    radius_limits: F64  # (P,) float64 `CameraModel.radius_limit`

    @classmethod
    def of(cls, models: Sequence[CameraModel]) -> Self:
        """The lenses of these cameras, in their order."""
        n = len(models)
        return cls(
            np.array([model.K for model in models]).reshape(n, 3, 3),
            np.array([model.coefficients for model in models]).reshape(n, 8),
            np.array([model.model == "equidistant" for model in models], np.bool_),
            np.array([model.radius_limit for model in models], np.float64),
        )

    @cached_property
    def bent(self) -> Bools:
        """(P,) whether a straight line may be bent in the image."""
        return np.asarray(self.equidistant | self.coefficients.any(1))

    @cached_property
    def bends(self) -> bool:
        """Whether any image may bend straight lines."""
        return bool(self.bent.any())

    @property
    def arrays(self) -> tuple[F64, F64, Bools, F64]:
        """The fields, as compiled functions take them."""
        return self.K, self.coefficients, self.equidistant, self.radius_limits

    def project(self, points_camera: F64) -> tuple[F64, Bools]:
        """`CameraModel.project` of points (P, S, 3), each row by its own camera.

        Returns:
            (P, S, 2) pixels, and (P, S) whether each point is in front of its camera and within its lens model.
        """
        return _pixels_of_points(np.ascontiguousarray(points_camera), *self.arrays)

    def rays_of_pixels(self, pixels: F64) -> tuple[F64, Bools]:
        """Directions of the pixels (P, S, 2) of each camera: the inverse of projection, lens distortion included.

        By Newton's method from the ray of a lens without distortion. The lens bends a radius by a monotone function, so
        that it converges wherever the lens model has an image of a ray.

        Returns:
            (P, S, 3) directions in the optical frames, of depth 1; and (P, S) whether there is such a ray. Where there
            is none, the direction is the optical axis.
        """
        return _rays_of_pixels(np.ascontiguousarray(pixels), *self.arrays)

    def rectangles_of_boxes(self, corners_camera: F64, image_sizes: F64) -> F64:
        """`CameraModel.project_boxes`, each box by its own camera.

        Args:
            corners_camera: (P, 8, 3) corners in the order of `geometry.box_corners`, metres in the optical frames.
            image_sizes: (P, 2) width and height of the images, pixels.

        Returns:
            (P, 4) left, top, right, bottom in pixels; NaN where nothing of a box is in the image.
        """
        start, end, is_ahead = edges_ahead(corners_camera, NEAR_M)
        shares = EDGE_SHARES[:, None]
        samples = start[:, :, None] * (1 - shares) + end[:, :, None] * shares  # (P, 12, S, 3)
        pixels, valid = self.project(samples.reshape(len(samples), -1, 3))
        valid &= np.repeat(is_ahead, len(shares), axis=1)
        low = np.where(valid[..., None], pixels, np.inf).min(1, initial=np.inf)
        high = np.where(valid[..., None], pixels, -np.inf).max(1, initial=-np.inf)
        found = np.column_stack([np.clip(low, 0, image_sizes), np.clip(high, 0, image_sizes)])
        is_seen = (found[:, 2] > found[:, 0]) & (found[:, 3] > found[:, 1])
        return np.where(is_seen[:, None], found, np.nan)


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({BLOCK}, {LENSES})")
def _pixels_of_points(points: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """See `Lenses.project`; the arguments after the first are the fields of `Lenses`."""
    pixels, valid = np.empty((*points.shape[:2], 2)), np.empty(points.shape[:2], np.bool_)
    for p in range(points.shape[0]):
        lens = lens_of(K[p], coefficients[p], equidistant[p])
        for s in range(points.shape[1]):
            x, y, z = points[p, s, 0], points[p, s, 1], points[p, s, 2]
            u, v, is_valid = pixel_of(x, y, z, lens, equidistant[p], limits[p])
            pixels[p, s, 0], pixels[p, s, 1], valid[p, s] = u, v, is_valid
    return pixels, valid


@compiled(f"Tuple((float64[:, :, ::1], boolean[:, ::1]))({BLOCK}, {LENSES})")
def _rays_of_pixels(pixels: F64, K: F64, coefficients: F64, equidistant: Bools, limits: F64) -> tuple[F64, Bools]:
    """See `Lenses.rays_of_pixels`."""
    rays, found = np.zeros((*pixels.shape[:2], 3)), np.zeros(pixels.shape[:2], np.bool_)
    for p in range(pixels.shape[0]):
        lens = lens_of(K[p], coefficients[p], equidistant[p])
        fx, fy, cx, cy, skew = lens[:5]
        for s in range(pixels.shape[1]):
            y = (pixels[p, s, 1] - 0.5 - cy) / fy
            x = (pixels[p, s, 0] - 0.5 - cx - skew * y) / fx
            for _ in range(MAX_STEPS):
                u, v, valid = pixel_of(x, y, 1.0, lens, equidistant[p], limits[p])
                right, down = pixels[p, s, 0] - u, pixels[p, s, 1] - v
                found[p, s] = valid and abs(right) <= NEAR_PX and abs(down) <= NEAR_PX
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
