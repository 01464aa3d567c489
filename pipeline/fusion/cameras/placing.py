"""Where the object of a 2D box stands, as far as one camera can tell.

The edges of the box tell the range thrice: where its lower edge meets the ground, how high it is, and how wide. A class
has its typical size and ground is nearly flat, but neither is exact, and the width depends on the heading. So for each
of a number of headings, the range is found by least squares over the directions of the lower and upper edge and the
width, whose errors are those of pixels, of the size and of the ground together: what two of them share counts once.
How well the three agree says how likely each heading is. The range is sought as its logarithm, in which perspective is
nearly linear.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, Rows, select_rows
from pipeline.core.settings.classes import ClassPrior
from pipeline.fusion.cameras.observed import Noise, Observed, observe
from pipeline.fusion.cameras.placing_kernels import least_squares
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["HEADINGS", "Ground", "Placements", "SizePriors", "place"]

Ground = Callable[[F64], F64]
"""Z of the ground at points (..., 2) of the site frame, metres."""

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

FORWARD, LEFT = np.array([1.0, -1, -1, 1]), np.array([1.0, 1, -1, -1])
"""The corners of an object seen from above, in halves of its length and width."""

SHARES = np.array(
    [ROOF_SHARE, CONTACT_SHARE, SHAPE_STD, NEAREST_SHARE, FIRST_STD, FIRST_STD**2, FIRST_STD**-2], np.float64
)
"""As `least_squares` takes them."""

SIZE_STD_SHARE = 0.06
"""Smallest standard deviation of a class's size, as a share of it."""

LENGTH_STD_SHARE = 0.4
"""The same, as a share of that of the length."""


@dataclass(frozen=True, eq=False)
class SizePriors:
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


@dataclass(frozen=True, eq=False)
class _Shape:
    """Extents of P objects in the frame of the ray to their centre, under each heading, metres.

    Attributes:
        along: (P, H, 4) of the corners, from the centre away from the camera.
        aside: (P, H, 4) of the same corners, to the left.
        depth: (P, H) from the centre to the nearest corner, along the ray.
        height: (P, 1)
        depth_std: (P, H) standard deviation of `depth`.
        across_std: (P, H) of the width as seen.
        height_std: (P, 1)
    """

    along: F64
    aside: F64
    depth: F64
    height: F64
    depth_std: F64
    across_std: F64
    height_std: F64

    @classmethod
    def of(cls, bearing: F64, mean_m: F64, std_m: F64) -> "_Shape":
        turn = HEADINGS - bearing[:, None]
        cos, sin = np.cos(turn), np.sin(turn)
        length, width, height = mean_m.T[..., None]
        length_std, width_std, height_std = std_m.T[..., None]
        forward, left = length[..., None] / 2 * FORWARD, width[..., None] / 2 * LEFT
        return cls(
            forward * cos[..., None] - left * sin[..., None],
            forward * sin[..., None] + left * cos[..., None],
            (length * np.abs(cos) + width * np.abs(sin)) / 2,
            height,
            np.hypot(length_std * cos, width_std * sin) / 2,
            np.hypot(length_std * sin, width_std * cos),
            height_std,
        )

    def away(self, range_m: F64) -> F64:
        """(P, H, 4) of the corners from the camera, along the ray to the centre, whose range is given (P, H)."""
        return np.maximum(range_m[..., None] + self.along, NEAREST_SHARE * range_m[..., None])

    def sides(self, range_m: F64) -> tuple[F64, F64]:
        """Bearings of the left and the right side from the centre, whose range is given (P, H)."""
        bearing = np.arctan2(self.aside, self.away(range_m))
        return bearing.max(-1), bearing.min(-1)


def place(sightings: Sightings, priors: SizePriors, ground: Ground, noise: Noise) -> Placements:
    """Place the object of each of P 2D boxes, of which some may be sightings of one object.

    Args:
        sightings: The boxes.
        priors: Sizes by class.
        ground: Of the site.
        noise: Of the observations.
    """
    seen = observe(sightings, noise)
    class_ids = sightings.class_ids
    shape = _Shape.of(seen.middle, priors.mean_m[class_ids], priors.std_m[class_ids])
    towards = np.stack([np.cos(seen.middle), np.sin(seen.middle)], 1)
    camera = sightings.origin

    def rise(range_m: F64) -> F64:
        """Height of the ground above the camera at a range."""
        return ground(camera[:, None, :2] + range_m[..., None] * towards[:, None]) - camera[:, None, 2]

    height_seen = np.maximum(seen.upper - seen.lower, 1e-6)[:, None]
    first_m = shape.height / height_seen + shape.depth
    range_m = first_m
    for _ in range(STEPS):
        step, _, _ = _improve(seen, shape, range_m, first_m, rise, noise)
        range_m = range_m * np.exp(np.clip(step, -MAX_STEP, MAX_STEP))
    _, information, log_likelihood = _improve(seen, shape, range_m, first_m, rise, noise)
    return _laid_out(seen, shape, camera, range_m, information, log_likelihood, noise)


def _improve(
    seen: Observed, shape: _Shape, range_m: F64, first_m: F64, rise: Callable[[F64], F64], noise: Noise
) -> tuple[F64, F64, F64]:
    """A step of least squares in the range's logarithm, its information, and the log-likelihood, (P, H) each."""
    contact_m = np.maximum(range_m - CONTACT_SHARE * shape.depth, NEAREST_SHARE * range_m)
    away_m = shape.away(range_m)
    back = np.log(first_m / range_m)
    step, information, square, product = least_squares(
        range_m,
        contact_m,
        rise(contact_m),
        rise(range_m),
        back,
        away_m,
        shape.aside,
        np.arctan2(shape.aside, away_m),
        shape.depth,
        shape.depth_std,
        shape.across_std,
        np.concatenate([shape.height, shape.height_std], 1),
        np.column_stack([seen.lower, seen.upper, seen.width, seen.stds]),
        np.array([noise.ground_slope**2, noise.ground_m]),
        SHARES,
    )
    return step, information, -(square + np.log(product)) / 2


def _laid_out(
    seen: Observed, shape: _Shape, camera: F64, range_m: F64, information: F64, log_likelihood: F64, noise: Noise
) -> Placements:
    """Ranges as places: the centre is half a width from either side, and nearer to the better known one."""
    left, right = shape.sides(range_m)
    variances = seen.stds[:, ::2, None] ** 2
    share = variances[:, 1] / variances.sum(1)  # of the left side
    by_left, by_right = seen.left[:, None] - left, (seen.left - seen.width)[:, None] - right
    bearing = share * by_left + (1 - share) * by_right
    size_std = (share - 0.5) * shape.across_std / range_m
    bearing_std = np.sqrt(
        share**2 * variances[:, 0] + (1 - share) ** 2 * variances[:, 1] + size_std**2 + noise.bearing_rad**2
    )
    cos, sin = np.cos(bearing), np.sin(bearing)
    along, across = range_m**2 / information, (range_m * bearing_std) ** 2
    covariances = np.stack(
        [
            np.stack([along * cos**2 + across * sin**2, (along - across) * cos * sin], -1),
            np.stack([(along - across) * cos * sin, along * sin**2 + across * cos**2], -1),
        ],
        -2,
    )
    xy = camera[:, None, :2] + range_m[..., None] * np.stack([cos, sin], -1)
    return Placements(xy, covariances, log_likelihood)
