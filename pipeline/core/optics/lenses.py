"""The lens models of `core.camera` for many cameras at once: points in images, and rays of pixels.

Each row of points is projected by a camera of its own, so that boxes seen by several cameras are one computation.
`native/lenses.h` has the formulas.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, CheckedTable
from lidcam.pipeline.core.camera import NEAR_M, CameraModel, rectangles_around
from lidcam.pipeline.core.geometry.box_edges import edge_samples
from lidcam.pipeline.native.kernels import pixels_of_points, rays_of_pixels


def may_show(models: Sequence[CameraModel], centers_camera: F64, radii_m: F64) -> Bools:
    """(C, N) whether spheres reach into the cones of what C cameras may show.

    Spheres have centres (C, N, 3) in the optical frames and radii (N,), metres.
    """
    x, y, z = np.moveaxis(centers_camera, -1, 0)
    range_m = np.sqrt(x * x + y * y + z * z)
    reach = np.where(range_m > radii_m, np.arcsin(radii_m / np.maximum(np.maximum(range_m, radii_m), 1e-9)), np.pi)
    aside = np.arctan2(np.sqrt(x * x + y * y), z)
    angles_rad = np.array([model.view_angle_rad for model in models]).reshape(-1, 1)
    return np.asarray((z + radii_m > NEAR_M) & (aside - reach < angles_rad))


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
        """The fields, as kernels take them."""
        return self.K, self.coefficients, self.equidistant, self.radius_limits

    def project(self, points_camera: F64) -> tuple[F64, Bools]:
        """`CameraModel.project` of points (P, S, 3), each row by its own camera.

        Returns (P, S, 2) pixels, and (P, S) whether each point is in front of its camera and within its lens model.
        """
        return pixels_of_points(np.ascontiguousarray(points_camera), *self.arrays)

    def rays_of_pixels(self, pixels: F64) -> tuple[F64, Bools]:
        """Directions of the pixels (P, S, 2) of each camera: the inverse of projection, lens distortion included.

        By Newton's method from the ray of a lens without distortion. The lens bends a radius by a monotone function, so
        that it converges wherever the lens model has an image of a ray. Returns (P, S, 3) directions in the optical
        frames, of depth 1; and (P, S) whether there is such a ray. Where there is none, the direction is the optical
        axis.
        """
        return rays_of_pixels(np.ascontiguousarray(pixels), *self.arrays)

    def rectangles_of_boxes(self, corners_camera: F64, image_sizes: F64) -> F64:
        """(P, 4) `CameraModel.project_boxes` of corners (P, 8, 3), each box by its own camera.

        `image_sizes` (P, 2) are width and height of the images, pixels.
        """
        samples, is_ahead = edge_samples(corners_camera, NEAR_M)
        pixels, valid = self.project(samples.reshape(len(samples), -1, 3))
        return rectangles_around(
            pixels.reshape(*samples.shape[:3], 2), valid.reshape(is_ahead.shape) & is_ahead, image_sizes
        )
