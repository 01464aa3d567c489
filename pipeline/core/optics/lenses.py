"""The lens models of `core.camera` for many cameras at once, and their derivatives.

Each row of points is projected by a camera of its own, so that boxes seen by several cameras are one computation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pipeline.core.arrays import F64, Bools, Rows, check_array, select_rows
from pipeline.core.camera import CameraModel
from pipeline.core.optics.lens_kernels import pixels_of_points, slopes_of_points

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
    def bent(self) -> Bools:
        """(P,) whether a straight line may be bent in the image."""
        return np.asarray(self.equidistant | self.coefficients.any(1))

    @cached_property
    def bends(self) -> bool:
        """Whether that is so in one of the images."""
        return bool(self.bent.any())

    @property
    def arrays(self) -> tuple[F64, F64, Bools, F64]:
        """The fields, as `core.optics.lens_kernels` takes them."""
        return self.K, self.coefficients, self.equidistant, self.radius_limits

    def project(self, points_camera: F64) -> tuple[F64, Bools]:
        """As `CameraModel.project`, each row by its own camera.

        Args:
            points_camera: (P, S, 3) metres in the optical frames.

        Returns:
            (P, S, 2) pixels, and (P, S) whether each point is in front of its camera and within its lens model.
        """
        return pixels_of_points(np.ascontiguousarray(points_camera), *self.arrays)

    def jacobians(self, points_camera: F64) -> F64:
        """Derivatives of the pixels by the points.

        Args:
            points_camera: (P, S, 3) metres in the optical frames; meaningful where `project` says that they are valid.

        Returns:
            (P, S, 2, 3) pixels per metre.
        """
        return slopes_of_points(np.ascontiguousarray(points_camera), *self.arrays)
