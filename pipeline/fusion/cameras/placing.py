"""Where the object of a 2D box stands, as far as one camera can tell.

The edges of the box tell the range thrice: where its lower edge meets the ground, how high it is, and how wide. A class
has its typical size and ground is nearly flat, but neither is exact, and the width depends on the heading. So for each
of a number of headings, the range is found by least squares over the directions of the lower and upper edge and the
width, whose errors are those of pixels, of the size and of the ground together: what two of them share counts once.
How well the three agree says how likely each heading is. The range is sought as its logarithm, in which perspective is
nearly linear.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, Rows, select_rows
from pipeline.core.settings.classes import ClassPrior
from pipeline.fusion.cameras.ground import Ground
from pipeline.fusion.cameras.observed import Noise, observe
from pipeline.fusion.cameras.placing_kernels import (
    bearings_between_sides,
    corners_seen,
    laid_out,
    least_squares,
    places_at,
    rises,
)
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["HEADINGS", "Placements", "SizePriors", "place"]

HEADINGS = np.arange(12) * (np.pi / 12)
"""The headings tried, radians about +z of the site; front and rear look alike."""

STEPS = 4

MAX_STEP = 0.7
"""Largest change of the range's logarithm in one step."""

FIRST_STD = 0.7
"""Standard deviation of the range's logarithm by the height of the box alone, which holds where edges are cut."""

CONTACT_SHARE = 0.8
"""Where the lower edge touches the ground: this share of the way from the centre to the box's nearest corner. Wheels
stand behind bumpers."""

ROOF_SHARE = 0.4
"""Where the upper edge is, in the same measure: roofs are shorter than vehicles, and rounded."""

SHAPE_STD = 0.2
"""Standard deviation of either share."""

NEAREST_SHARE = 0.1
"""No part of an object is nearer to the camera than this share of the range of its centre."""

FORWARD, LEFT = np.array([[1.0, -1, -1, 1]]), np.array([[1.0, 1, -1, -1]])
"""The corners of an object seen from above, in halves of its length and width."""

SHARES = np.array(
    [ROOF_SHARE, CONTACT_SHARE, SHAPE_STD, NEAREST_SHARE, FIRST_STD, FIRST_STD**2, FIRST_STD**-2], np.float64
)
"""As `least_squares` takes them."""

SIZE_STD_SHARE = 0.06
"""Smallest standard deviation of a class's size, as a share of it."""

LENGTH_STD_SHARE = 0.4
"""The same, as a share of that of the length."""


class SizePriors(NamedTuple):
    """Sizes of C classes.

    Attributes:
        mean_m: (C, 3) float64 length, width, height.
        std_m: (C, 3) float64.
    """

    mean_m: F64
    std_m: F64

    @classmethod
    def of(cls, classes: tuple[ClassPrior, ...]) -> "SizePriors":
        """The largest size is taken for three standard deviations from the typical one.

        A class whose lengths differ much also differs in the other extents: a van is a small truck.
        """
        mean = np.array([prior.size_m for prior in classes])
        share = np.array([prior.max_size_m for prior in classes]) / mean / 3 - 1 / 3
        least = np.maximum(SIZE_STD_SHARE, LENGTH_STD_SHARE * share[:, :1])
        return cls(mean, np.maximum(share, least) * mean)


@dataclass(frozen=True, eq=False)
class Placements:
    """Where P objects stand, for each of the H `HEADINGS`.

    Attributes:
        xy: (P, H, 2) float64 centre, metres in the site frame.
        covariances: (P, H, 2, 2) float64, m^2.
        log_weights: (P, H) float64 logarithm of how likely each heading is; not normalised.
    """

    xy: F64
    covariances: F64
    log_weights: F64

    def select(self, rows: Rows) -> "Placements":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)


class _Shape(NamedTuple):
    """Extents of P objects in the frame of the ray to their centre, under each heading, metres.

    Attributes:
        along: (P, H, 4) of the corners, from the centre away from the camera.
        aside: (P, H, 4) of the same corners, to the left.
        depth: (P, H) from the centre to the nearest corner, along the ray.
        depth_std: (P, H) standard deviation of `depth`.
        across_std: (P, H) of the width as seen.
        heights: (P, 2) height, and its standard deviation.
    """

    along: F64
    aside: F64
    depth: F64
    depth_std: F64
    across_std: F64
    heights: F64

    @classmethod
    def of(cls, bearing: F64, mean_m: F64, std_m: F64) -> "_Shape":
        turn = HEADINGS - bearing[:, None]
        cos, sin = np.cos(turn), np.sin(turn)
        length_std, width_std = std_m[:, :1], std_m[:, 1:2]
        return cls(
            *corners_seen(cos, sin, mean_m, FORWARD, LEFT),
            np.hypot(length_std * cos, width_std * sin) / 2,
            np.hypot(length_std * sin, width_std * cos),
            np.array([mean_m[:, 2], std_m[:, 2]]).T.copy(),
        )


def place(sightings: Sightings, priors: SizePriors, ground: Ground, noise: Noise) -> Placements:
    """Place the object of each of P 2D boxes, of which some may be sightings of one object.

    Args:
        sightings: The boxes.
        priors: Sizes by class.
        ground: Of the site.
        noise: Of the observations.
    """
    seen, class_ids = observe(sightings, noise), sightings.class_ids
    shape = _Shape.of(seen.middle, priors.mean_m[class_ids], priors.std_m[class_ids])
    towards = np.array([np.cos(seen.middle), np.sin(seen.middle)]).T.copy()
    edges = np.column_stack([seen.lower, seen.upper, seen.width, seen.stds])
    ground_noise = np.array([noise.ground_slope**2, noise.ground_m])

    def improve(range_m: F64) -> tuple[F64, F64]:
        """What `least_squares` gives at a range (P, H), and bearings of the corners (P, H, 4) from the centre."""
        contact_m, back, away_m, places = places_at(
            range_m, first_m, shape.depth, shape.along, towards, sightings.origin, CONTACT_SHARE, NEAREST_SHARE
        )
        bearing = np.arctan2(shape.aside, away_m)
        contact_rise_m, rise_m = rises(
            places, places @ ground.plane[:2], sightings.origin, ground.plane, ground.relief_m, ground.grid
        )
        at_range = range_m, contact_m, contact_rise_m, rise_m, np.log(back), away_m, shape.aside, bearing
        sizes = shape.depth, shape.depth_std, shape.across_std, shape.heights
        return least_squares(*at_range, *sizes, edges, ground_noise, SHARES), bearing

    height_seen = np.maximum(seen.upper - seen.lower, 1e-6)[:, None]
    first_m = shape.heights[:, :1] / height_seen + shape.depth
    range_m = first_m
    for _ in range(STEPS):
        found, _ = improve(range_m)
        range_m = range_m * np.exp(found[0].clip(-MAX_STEP, MAX_STEP))
    (_, information, square, product), corners = improve(range_m)
    sides = np.array([seen.left, seen.width]).T.copy()
    bearing, std = bearings_between_sides(corners, sides, seen.stds, shape.across_std, range_m, noise.bearing_rad)
    xy, covariances = laid_out(sightings.origin, range_m, information, std, np.cos(bearing), np.sin(bearing))
    return Placements(xy, covariances, -(square + np.log(product)) / 2)
