"""What 2D boxes say about objects that stand upright: directions and extents as seen from the camera."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.fusion.sightings import Sightings

__all__ = ["CUT_SHARE", "Noise", "Observed", "observe"]

CUT_SHARE = 0.5
"""Standard deviation of an edge that the border of the image has cut, as a share of the box: the object goes on."""

HIDDEN_SHARE = 0.25
"""The same of a lower edge that another object may hide."""

HIDDEN_WIDTH_SHARE = 0.3
"""A box that begins below another one's lower edge hides it if it covers this share of its width."""

LOWER_SHARE = 0.05
"""A lower edge counts as further down from this share of the box on."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what a placement rests on.

    Attributes:
        pixel_px: Of an edge of a 2D box.
        box_share: The same, as a share of the box's extent; both add up.
        ground_m: Of the height of the ground.
        ground_slope: Of its slope between camera and object, rise over run.
    """

    pixel_px: float
    box_share: float
    ground_m: float
    ground_slope: float


@dataclass(frozen=True, eq=False)
class Observed:
    """P 2D boxes as (P,) float64 each.

    Attributes:
        left: Bearing of the left edge about +z of the site, radians.
        width: Bearing of the left edge minus that of the right one, radians.
        lower: Slope of the ray to the middle of the lower edge, rise over run; below 0 downwards.
        upper: The same of the upper edge.
        side_std: Standard deviation of a bearing of one side, radians.
        lower_std: Of `lower`.
        upper_std: Of `upper`.
        is_cut: (P, 2) whether the left and the right side are cut by the border.
    """

    left: F64
    width: F64
    lower: F64
    upper: F64
    side_std: F64
    lower_std: F64
    upper_std: F64
    is_cut: Bools

    @property
    def middle(self) -> F64:
        """Bearing of the middle of the box, radians."""
        return self.left - self.width / 2


def observe(sightings: Sightings, noise: Noise) -> Observed:
    """The directions and extents of 2D boxes, and how well they are known."""
    run = np.maximum(np.hypot(sightings.rays[..., 0], sightings.rays[..., 1]), 1e-9)
    slope = sightings.rays[..., 2] / run
    bearing = np.arctan2(sightings.rays[..., 1], sightings.rays[..., 0])
    width, lower, upper = wrap_angle(bearing[:, 7] - bearing[:, 3]), slope[:, 5], slope[:, 1]
    extent_px = sightings.xyxy[:, 2:] - sightings.xyxy[:, :2]
    share = np.hypot(noise.pixel_px / extent_px, noise.box_share)
    cut = np.where(sightings.cut, CUT_SHARE, 0.0)
    hidden = np.where(_is_hidden_below(sightings), HIDDEN_SHARE, 0.0)
    height = np.abs(upper - lower)
    return Observed(
        bearing[:, 7],
        width,
        lower,
        upper,
        np.abs(width) * share[:, 0],
        height * np.sqrt(share[:, 1] ** 2 + cut[:, 3] ** 2 + hidden**2),
        height * np.hypot(share[:, 1], cut[:, 1]),
        sightings.cut[:, ::2],
    )


def _is_hidden_below(sightings: Sightings) -> Bools:
    """(P,) whether a nearer object, whose box reaches further down, may hide the lower edge of each box."""
    hidden = np.zeros(len(sightings), np.bool_)
    for camera in np.unique(sightings.cameras):
        rows = np.flatnonzero(sightings.cameras == camera)
        left, top, right, bottom = sightings.xyxy[rows].T
        common = np.minimum(right[:, None], right) - np.maximum(left[:, None], left)
        covers = common >= HIDDEN_WIDTH_SHARE * (right - left)[:, None]
        beyond = (top < bottom[:, None]) & (bottom > bottom[:, None] + LOWER_SHARE * (bottom - top)[:, None])
        hidden[rows] = (covers & beyond).any(1)
    return hidden
