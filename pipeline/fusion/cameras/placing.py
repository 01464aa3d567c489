"""Where the object of a 2D box stands, as far as one camera can tell.

The edges of the box tell the range thrice: where its lower edge meets the ground, how high it is, and how wide. A class
has its typical size and ground is nearly flat, but neither is exact, and the width depends on the heading. So for each
of a number of headings, the range is found by least squares over the directions of the lower and upper edge and the
width, whose errors are those of pixels, of the size and of the ground together: what two of them share counts once.
How well the three agree says how likely each heading is. The range is sought as its logarithm, in which perspective is
nearly linear.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Table
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.fusion.cameras.sightings import Noise, Observed, Sightings, observe

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

FORWARD, LEFT = np.array([1.0, -1, -1, 1]).reshape(4, 1, 1), np.array([1.0, 1, -1, -1]).reshape(4, 1, 1)
"""The corners of an object seen from above, in halves of its length and width."""

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
    def of(cls, classes: Sequence[ClassPrior]) -> "SizePriors":
        """The largest size is taken for three standard deviations from the typical one.

        A class whose lengths differ much also differs in the other extents: a van is a small truck.
        """
        mean = np.array([prior.size_m for prior in classes])
        share = np.array([prior.max_size_m for prior in classes]) / mean / 3 - 1 / 3
        least = np.maximum(SIZE_STD_SHARE, LENGTH_STD_SHARE * share[:, :1])
        return cls(mean, np.maximum(share, least) * mean)


@dataclass(frozen=True, eq=False)
class Placements(Table):
    """Where P objects stand, for each of the H `HEADINGS`.

    Attributes:
        xy: (P, H, 2) float64 centre, metres in the site frame.
        covariances: (P, H, 2, 2) float64, m^2.
        log_weights: (P, H) float64 logarithm of how likely each heading is; not normalised.
    """

    xy: F64
    covariances: F64
    log_weights: F64

    @classmethod
    def empty(cls) -> "Placements":
        """Of no objects."""
        h = len(HEADINGS)
        return cls(np.zeros((0, h, 2)), np.zeros((0, h, 2, 2)), np.zeros((0, h)))

    def copy(self) -> "Placements":
        """The same in arrays of its own."""
        return Placements(self.xy.copy(), self.covariances.copy(), self.log_weights.copy())


class Placed(NamedTuple):
    """Objects that cameras place, and their sightings.

    Attributes:
        boxes: Of source CAMERA.
        sightings: The 2D boxes of all cameras.
        objects: (P,) int64 row of `boxes` that each sighting belongs to.
        placements: Where each sighting by itself sees its object.
        out_of_image: Number of other 2D boxes, of which nothing lies in the image.
    """

    boxes: Boxes3D
    sightings: Sightings
    objects: I64
    placements: Placements
    out_of_image: int = 0


class _Shape(NamedTuple):
    """Extents of P objects in the frame of the ray to their centre, under each heading, metres.

    Attributes:
        along: (4, P, H) of the corners, from the centre away from the camera.
        aside: (4, P, H) of the same corners, to the left.
        depth: (P, H) from the centre to the nearest corner, along the ray.
        variances: (2, P, H) of where the lower and the upper edge are along the ray, m^2.
        across_std: (P, H) standard deviation of the width as seen.
        height: (P, 1)
        height_std: (P, 1)
    """

    along: F64
    aside: F64
    depth: F64
    variances: F64
    across_std: F64
    height: F64
    height_std: F64

    @classmethod
    def of(cls, bearing: F64, mean_m: F64, std_m: F64) -> "_Shape":
        turn = HEADINGS - bearing[:, None]
        cos, sin = np.cos(turn), np.sin(turn)
        length, width, height = mean_m.T[..., None]
        length_std, width_std, height_std = std_m.T[..., None]
        ahead, beside = length / 2 * FORWARD, width / 2 * LEFT
        depth = (length * np.abs(cos) + width * np.abs(sin)) / 2
        by_depth = (SHAPE_STD * depth) ** 2
        by_contact = (CONTACT_SHARE * (np.hypot(length_std * cos, width_std * sin) / 2)) ** 2
        return cls(
            ahead * cos - beside * sin,
            ahead * sin + beside * cos,
            depth,
            np.array([by_depth + by_contact, by_depth]),
            np.hypot(length_std * sin, width_std * cos),
            height,
            height_std,
        )


class _Fit(NamedTuple):
    """How ranges of P objects fit their 2D boxes under each of H headings.

    Attributes:
        step: (P, H) by which the range's logarithm is to be changed.
        information: (P, H) of that logarithm.
        squared: (P, H) squared error in standard deviations.
        variances: (P, H) product of the variances.
        left, right: (P, H) bearings of the outermost corners from the ray to the centre, radians.
    """

    step: F64
    information: F64
    squared: F64
    variances: F64
    left: F64
    right: F64


def place(sightings: Sightings, priors: SizePriors, ground_m: Callable[[F64], F64], noise: Noise) -> Placements:
    """Place the object of each of P 2D boxes, of which some may be sightings of one object.

    Args:
        sightings: The boxes.
        priors: Sizes by class.
        ground_m: Height of the ground at places (..., 2) of the site.
        noise: Of the observations.
    """
    seen, class_ids = observe(sightings, noise), sightings.class_ids
    shape = _Shape.of(seen.middle, priors.mean_m[class_ids], priors.std_m[class_ids])
    towards = np.stack([np.cos(seen.middle), np.sin(seen.middle)], 1)[:, None]

    def rise_m(range_m: F64) -> F64:
        """Height of the ground above the camera at ranges (..., P, H)."""
        return ground_m(sightings.origin[:, None, :2] + range_m[..., None] * towards) - sightings.origin[:, 2:]

    height_seen = np.maximum(seen.upper - seen.lower, 1e-6)[:, None]
    first_m = shape.height / height_seen + shape.depth
    range_m = first_m
    for _ in range(STEPS):
        step = _fit(range_m, first_m, shape, seen, rise_m, noise).step
        range_m = range_m * np.exp(np.minimum(np.maximum(step, -MAX_STEP), MAX_STEP))
    fit = _fit(range_m, first_m, shape, seen, rise_m, noise)
    xy, covariances = _laid_out(sightings.origin, range_m, fit, shape, seen, noise)
    return Placements(xy, covariances, -(fit.squared + np.log(fit.variances)) / 2)


def _fit(range_m: F64, first_m: F64, shape: _Shape, seen: Observed, rise_m: Callable[[F64], F64], noise: Noise) -> _Fit:
    """One step of least squares for the logarithm of the range.

    Args:
        range_m: (P, H) of the centre.
        first_m: (P, H) by the height of the box alone.
        shape: Of the objects.
        seen: Of the 2D boxes.
        rise_m: Height of the ground above the camera at ranges (..., P, H).
        noise: Of the observations.
    """
    # Lower edge and upper edge: where they are, how high above the camera, and their slopes as seen.
    nearest_m, roof_m = NEAREST_SHARE * range_m, ROOF_SHARE * shape.depth
    at_m = np.array([np.maximum(range_m - CONTACT_SHARE * shape.depth, nearest_m), range_m])
    above_m = rise_m(at_m)
    above_m[1] += shape.height
    at_m[1] = np.maximum(range_m - np.where(above_m[1] > 0, roof_m, -roof_m), nearest_m)
    edges = above_m / at_m

    away_m = np.maximum(range_m + shape.along, nearest_m)
    bearing = np.arctan2(shape.aside, away_m)
    turning = -shape.aside / (away_m * away_m + shape.aside * shape.aside)
    leftmost, rightmost = bearing.argmax(0), bearing.argmin(0)
    left, right = leftmost.choose(bearing), rightmost.choose(bearing)

    # How lower edge, upper edge and width change with the range's logarithm, what those of the box differ by; twice.
    by_turn = leftmost.choose(turning) - rightmost.choose(turning)
    terms = np.empty((3, 4, *range_m.shape))
    terms[:2, :2], terms[2, :2] = (-edges * range_m / at_m)[:, None], by_turn * range_m
    terms[0, 2:], terms[1, 2:] = seen.lower[:, None] - edges[0], seen.upper[:, None] - edges[1]
    terms[2, 2:] = seen.width[:, None] - (left - right)

    left_variance, upper_variance, right_variance, lower_variance = seen.stds.T[..., None] ** 2
    shared = noise.ground_slope**2 + (noise.ground_m / range_m) ** 2
    of_lower, of_upper = shared + (edges / at_m) ** 2 * shape.variances
    of_lower, of_upper = of_lower + lower_variance, of_upper + (shape.height_std / range_m) ** 2 + upper_variance
    of_width = (shape.across_std / range_m) ** 2 + left_variance + right_variance
    determinant = of_lower * of_upper - shared * shared

    # Slopes with slopes, slopes with errors and errors with errors, by the inverse of the covariance of the three.
    (a, b, c), (d, e, f) = terms[:, :3], terms[:, 1:]
    both = of_upper * a * d + of_lower * b * e - shared * (a * e + b * d)
    information, pull, squared = both / determinant + c * f / of_width
    information, back = information + FIRST_STD**-2, np.log(first_m / range_m) / FIRST_STD
    step, variances = (pull + back / FIRST_STD) / information, determinant * of_width * information
    return _Fit(step, information, squared + back * back, variances, left, right)


def _laid_out(origin: F64, range_m: F64, fit: _Fit, shape: _Shape, seen: Observed, noise: Noise) -> tuple[F64, F64]:
    """(P, H, 2) centres, metres in the site frame, and (P, H, 2, 2) their covariances.

    A centre is half a width from either side of the 2D box, and nearer to the better known one.
    """
    first, last = seen.stds[:, :1] ** 2, seen.stds[:, 2:3] ** 2
    share = last / (first + last)  # of the left side
    by_left = seen.left[:, None] - fit.left
    by_right = (seen.left - seen.width)[:, None] - fit.right
    bearing = share * by_left + (1 - share) * by_right
    of_sides = share**2 * first + (1 - share) ** 2 * last
    by_size = (share - 0.5) * shape.across_std / range_m
    across = range_m**2 * (of_sides + by_size**2 + noise.bearing_rad**2)
    along, cos, sin = range_m**2 / fit.information, np.cos(bearing), np.sin(bearing)
    both = (along - across) * cos * sin
    covariances = np.stack([along * cos**2 + across * sin**2, both, both, along * sin**2 + across * cos**2], -1)
    xy = origin[:, None, :2] + range_m[..., None] * np.stack([cos, sin], -1)
    return xy, covariances.reshape(*range_m.shape, 2, 2)
