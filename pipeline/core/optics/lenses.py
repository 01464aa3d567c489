"""The lens models of `core.camera` for many cameras at once.

Each row of points is projected by a camera of its own, so that boxes seen by several cameras are one computation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pipeline.core.arrays import F64, Bools, Rows, check_array, select_rows
from pipeline.core.camera import EDGE_SHARES, NEAR_M, CameraModel
from pipeline.core.geometry.box_edges import edges_ahead
from pipeline.core.optics.lens_kernels import pixels_of_points

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

    def rectangles_of_boxes(self, corners_camera: F64, image_sizes: F64) -> F64:
        """As `CameraModel.project_boxes`, each box by its own camera.

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
