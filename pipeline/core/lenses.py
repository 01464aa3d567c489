"""The lens models of `core.camera` for many cameras at once, and their derivatives.

Each row of points is projected by a camera of its own, so that boxes seen by several cameras are one computation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pipeline.core.arrays import F64, Bools, Rows, check_array, select_rows
from pipeline.core.camera import NEAR_M, CameraModel

__all__ = ["Lenses"]


@dataclass(frozen=True, eq=False)
class Lenses:
    """Intrinsics of P cameras, row by row.

    Attributes:
        K: (P, 3, 3) float64 camera matrices, pixels.
        coefficients: (P, 8) float64 distortion, in the order of its model; missing ones are zero.
        equidistant: (P,) whether the model is `equidistant`; the others are cases of `rational_polynomial`.
        radius_limits: (P,) float64 `CameraModel.radius_limit`.
    """

    K: F64
    coefficients: F64
    equidistant: Bools
    radius_limits: F64

    def __post_init__(self) -> None:
        n = len(self.K)
        check_array("K", self.K, (n, 3, 3), np.float64)
        check_array("coefficients", self.coefficients, (n, 8), np.float64)
        check_array("equidistant", self.equidistant, (n,), np.bool_)
        check_array("radius_limits", self.radius_limits, (n,), np.float64)

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

    def select(self, rows: Rows) -> "Lenses":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)

    @cached_property
    def bends(self) -> bool:
        """Whether a straight line may be bent in one of the images."""
        return bool(self.equidistant.any() or self.coefficients.any())

    def project(self, points_camera: F64) -> tuple[F64, Bools]:
        """As `CameraModel.project`, each row by its own camera.

        Args:
            points_camera: (P, S, 3) metres in the optical frames.

        Returns:
            (P, S, 2) pixels, and (P, S) whether each point is in front of its camera and within its lens model.
        """
        x, y, front = _normalised(points_camera)
        if not self.bends:
            return self._pixels(x, y), front
        r2 = x * x + y * y
        inside, r2 = self._within(r2)
        scale, _ = self._radial(r2)
        tangential_1, tangential_2 = self._tangential()
        x_lens = x * scale + 2 * tangential_1 * x * y + tangential_2 * (r2 + 2 * x * x)
        y_lens = y * scale + tangential_1 * (r2 + 2 * y * y) + 2 * tangential_2 * x * y
        return self._pixels(x_lens, y_lens), front & inside

    def _pixels(self, x_lens: F64, y_lens: F64) -> F64:
        """(P, S, 2) pixels of points at the focal length 1."""
        K = self.K[:, None]
        pixels = np.empty((*x_lens.shape, 2))
        pixels[..., 0] = K[..., 0, 0] * x_lens + K[..., 0, 1] * y_lens + K[..., 0, 2] + 0.5
        pixels[..., 1] = K[..., 1, 1] * y_lens + K[..., 1, 2] + 0.5
        return pixels

    def jacobians(self, points_camera: F64) -> F64:
        """Derivatives of the pixels by the points.

        Args:
            points_camera: (P, S, 3) metres in the optical frames; meaningful where `project` says that they are valid.

        Returns:
            (P, S, 2, 3) pixels per metre.
        """
        x, y, front = _normalised(points_camera)
        if not self.bends:
            return self._straight_jacobians(x, y, np.where(front, points_camera[..., 2], 1.0))
        _, r2 = self._within(x * x + y * y)
        scale, slope = self._radial(r2)
        p1, p2 = self._tangential()
        xx = scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # x by y, and y by x
        yy = scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        K, per_depth = self.K[:, None], 1 / np.where(front, points_camera[..., 2], 1.0)
        found = np.empty((*x.shape, 2, 3))
        found[..., 0, 0] = (K[..., 0, 0] * xx + K[..., 0, 1] * xy) * per_depth
        found[..., 0, 1] = (K[..., 0, 0] * xy + K[..., 0, 1] * yy) * per_depth
        found[..., 1, 0] = K[..., 1, 1] * xy * per_depth
        found[..., 1, 1] = K[..., 1, 1] * yy * per_depth
        found[..., 2] = -found[..., 0] * x[..., None] - found[..., 1] * y[..., None]
        return found

    def _straight_jacobians(self, x: F64, y: F64, depth: F64) -> F64:
        """As `jacobians`, of lenses that do not bend, at x / z and y / z."""
        K, found = self.K[:, None, :2] / depth[..., None, None], np.zeros((*x.shape, 2, 3))
        found[..., :2] = K[..., :2]
        found[..., 2] = -K[..., 0] * x[..., None] - K[..., 1] * y[..., None]
        return found

    def _within(self, r2: F64) -> tuple[Bools, F64]:
        """Whether points of these squared radii are in the lens models, and the radii with 0 for the others."""
        radius = np.where(self.equidistant[:, None], np.arctan(np.sqrt(r2)), np.sqrt(r2))
        inside = radius < self.radius_limits[:, None]
        return inside, np.where(inside, r2, 0.0)

    def _tangential(self) -> tuple[F64, F64]:
        straight = self.equidistant
        p1, p2 = (np.where(straight, 0.0, self.coefficients[:, k])[:, None] for k in (2, 3))
        return p1, p2

    def _radial(self, r2: F64) -> tuple[F64, F64]:
        """Radial scale of points with squared radii (P, S), and its derivative by the squared radius."""
        k = self.coefficients.T[..., None]
        top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        bottom = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        scale = top / bottom
        top_slope = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4])
        bottom_slope = k[5] + r2 * (2 * k[6] + 3 * r2 * k[7])
        slope = (top_slope - scale * bottom_slope) / bottom
        if not self.equidistant.any():
            return scale, slope
        by_angle, slope_by_angle = _equidistant(r2, k)
        chosen = self.equidistant[:, None]
        return np.where(chosen, by_angle, scale), np.where(chosen, slope_by_angle, slope)


def _normalised(points_camera: F64) -> tuple[F64, F64, Bools]:
    """Of points x / z and y / z, and whether they are in front of the camera; else 1 stands for z."""
    front = points_camera[..., 2] > NEAR_M / 2
    depth = np.where(front, points_camera[..., 2], 1.0)
    return points_camera[..., 0] / depth, points_camera[..., 1] / depth, front


def _equidistant(r2: F64, k: F64) -> tuple[F64, F64]:
    """As `Lenses._radial`, for the equidistant model."""
    radius = np.sqrt(r2)
    theta = np.arctan(radius)
    t2 = theta * theta
    grown = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    growth = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    axis = radius < 1e-4  # there the quotients lose their digits: the series about the axis
    divisor = np.where(axis, 1.0, radius)
    scale = np.where(axis, 1 + (k[0] - 1 / 3) * r2, grown / divisor)
    slope = np.where(axis, k[0] - 1 / 3, (growth / (1 + r2) - scale) / (2 * divisor * divisor))
    return scale, slope
