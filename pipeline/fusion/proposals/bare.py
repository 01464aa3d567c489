"""Bare ground where cameras place objects without points: nothing stands there, whatever a 2D box shows.

Boxes of a camera that repeats its image, comes late, or was swapped with another one would else become objects. What
the lidars cannot see, as a black car that returns no light, still hides the ground below it.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.detections import Boxes3D

PLACES = np.linspace(-2.0, 2.0, 17)
"""Places that are looked at along the least known direction, in standard deviations."""

MIDDLE_SHARE = 0.25
"""Radius of the middle of an object, as a share of its width: beams pass below the edges of vehicles."""

MIN_GROUND_POINTS = 3
"""Minimum number of ground points in the middle of a place that is bare."""


def bare_shares(boxes: Boxes3D, ground_xyz: F32) -> F64:
    """(N,) probability by its covariance that each object would stand on ground that the lidars see.

    Args:
        boxes: N objects in the site frame, with covariances.
        ground_xyz: (G, 3) points on the ground, metres in the site frame.
    """
    weights = np.exp(-(PLACES**2) / 2)
    variances, axes = np.linalg.eigh(boxes.covariances[:, :2, :2])
    sigmas_m, radii_m = np.sqrt(variances[:, 1]), MIDDLE_SHARE * boxes.sizes[:, 1]
    is_bare = np.zeros((len(boxes), len(PLACES)), np.bool_)
    for row, (sigma_m, radius_m) in enumerate(zip(sigmas_m, radii_m, strict=True)):
        across, along = ((ground_xyz[:, :2] - boxes.centers[row, :2]) @ axes[row]).T
        near = np.abs(across) <= radius_m
        gaps = along[near, None] - sigma_m * PLACES
        is_bare[row] = (np.hypot(gaps, across[near, None]) <= radius_m).sum(0) >= MIN_GROUND_POINTS
    return np.asarray(is_bare @ (weights / weights.sum()))
