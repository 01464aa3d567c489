"""What 2D boxes say about objects that stand upright: directions and extents as seen from the camera."""

from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64
from pipeline.fusion.cameras.observed_kernels import extents_seen, hidden_edges
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["CUT_SHARE", "Noise", "Observed", "observe"]

CUT_SHARE = 10.0
"""Standard deviation of an edge that the border of the image has cut, as a share of the box: nothing is known of it."""

HIDDEN_SHARE = 0.25
"""The same of an edge that another object may hide."""

HIDDEN_EDGE_SHARE = 0.3
"""A nearer object hides an edge if its box covers this share of it."""

NEARER_SHARE = 0.05
"""An object is nearer than another one if its lower edge is further down by this share of the other one's box."""


class Noise(NamedTuple):
    """Standard deviations of what a placement rests on.

    Attributes:
        pixel_px: Of an edge of a 2D box.
        outline: The same, as a share of the box's size, the root of its area; both add up.
        ground_m: Of the height of the ground.
        ground_slope: Of its slope between camera and object, rise over run.
        bearing_rad: Of the direction in which a camera looks, about the vertical.
    """

    pixel_px: float
    outline: float
    ground_m: float
    ground_slope: float
    bearing_rad: float


class Observed(NamedTuple):
    """P 2D boxes as (P,) float64 each.

    Attributes:
        left: Bearing of the left edge about +z of the site, radians.
        width: Bearing of the left edge minus that of the right one, radians.
        lower: Slope of the ray to the middle of the lower edge, rise over run; below 0 downwards.
        upper: The same of the upper edge.
        stds: (P, 4) Standard deviations of left, top, right and bottom: of the bearings in radians, of the slopes as
            `lower` and `upper`.
    """

    left: F64
    width: F64
    lower: F64
    upper: F64
    stds: F64

    @property
    def middle(self) -> F64:
        """Bearing of the middle of the box, radians."""
        return self.left - self.width / 2


def observe(sightings: Sightings, noise: Noise) -> Observed:
    """The directions and extents of 2D boxes, and how well they are known."""
    runs = np.hypot(sightings.rays[..., 0], sightings.rays[..., 1])
    bearings = np.arctan2(sightings.rays[..., 1], sightings.rays[..., 0])
    hidden = hidden_edges(sightings.cameras, sightings.xyxy, HIDDEN_EDGE_SHARE, NEARER_SHARE)
    variances = np.array([noise.pixel_px**2, noise.outline**2, CUT_SHARE**2, HIDDEN_SHARE**2])
    return Observed(*extents_seen(sightings.rays, runs, bearings, sightings.xyxy, sightings.cut, hidden, variances))
