"""Position of the object of a 2D box by one camera.

Three features of the box give the range: where its lower edge meets the ground, its height, and its width. A class has
its typical size and ground is nearly flat, but neither is exact, and the width depends on the heading. So for each of a
number of headings, the range is found by least squares over the directions of the lower and upper edge and the width,
with errors of pixels, size and ground; errors that two of them share count once. Their agreement gives the likelihood
of each heading. The unknown is the logarithm of the range, in which perspective is nearly linear.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Table
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.fusion.cameras.sightings import Noise, Observed, Sightings, observe

HEADINGS = np.arange(12) * (np.pi / 12)
"""Headings to try, radians about +z of the site; front and rear look alike."""

STEPS = 4
"""Number of Gauss-Newton steps."""

MAX_STEP = 0.7
"""Maximum change of the range's logarithm in one step."""

FIRST_SIGMA = 0.7
"""Standard deviation of the range's logarithm by the height of the box alone, which holds for cut edges."""

CONTACT_SHARE = 0.8
"""Position of the ground contact, from the centre to the nearest corner: wheels stand behind bumpers."""

ROOF_SHARE = 0.4
"""Position of the upper edge in the same measure: roofs are shorter than vehicles, and rounded."""

SHAPE_SIGMA = 0.2
"""Standard deviation of either share."""

MIN_RANGE_SHARE = 0.1
"""Minimum range of any part of an object, as a share of the range of its centre."""

FORWARD, LEFT = np.array([1.0, -1, -1, 1]).reshape(4, 1, 1), np.array([1.0, 1, -1, -1]).reshape(4, 1, 1)
"""Corners of an object seen from above, in halves of its length and width."""

MIN_SIZE_SIGMA = 0.06
"""Minimum standard deviation of a class's extents, as a share of them."""

LENGTH_SIGMA_SHARE = 0.4
"""Minimum relative standard deviation of the other extents, as a share of that of the length."""


class SizePriors(NamedTuple):
    """Means and standard deviations (C, 3) of length, width and height of C classes, metres."""

    mean_m: F64
    std_m: F64

    @classmethod
    def of(cls, classes: Sequence[ClassPrior]) -> "SizePriors":
        """The maximum size is taken as three standard deviations above the typical one.

        A class with varied lengths also varies in the other extents: a van is a small truck.
        """
        mean = np.array([prior.size_m for prior in classes])
        share = np.array([prior.max_size_m for prior in classes]) / mean / 3 - 1 / 3
        min_share = np.maximum(MIN_SIZE_SIGMA, LENGTH_SIGMA_SHARE * share[:, :1])
        return cls(mean, np.maximum(share, min_share) * mean)


@dataclass(frozen=True, eq=False)
class Placements(Table):
    """Positions of P objects, for each of the H `HEADINGS`."""

    ROWS: ClassVar = {"xy": (len(HEADINGS), 2), "covariances": (len(HEADINGS), 2, 2), "log_weights": (len(HEADINGS),)}

    xy: F64  # (P, H, 2) float64 centre, metres in the site frame
    covariances: F64  # (P, H, 2, 2) float64, m^2
    log_weights: F64  # (P, H) float64 log likelihood of each heading; not normalised


class Placed(NamedTuple):
    """Objects that cameras place, and their sightings."""

    boxes: Boxes3D  # Boxes of source CAMERA
    sightings: Sightings  # The 2D boxes of all cameras
    objects: I64  # (P,) int64 row of `boxes` that each sighting belongs to
    placements: Placements  # Placement of its object by each sighting alone
    out_of_view: int = 0  # Number of other 2D boxes, which `see` leaves out


class _Shape(NamedTuple):
    """Extents of P objects in the frame of the ray to their centre, under each heading, metres."""

    along: F64  # (4, P, H) of the corners, from the centre away from the camera
    aside: F64  # (4, P, H) of the same corners, to the left
    depth: F64  # (P, H) from the centre to the nearest corner, along the ray
    variances: F64  # (2, P, H) of the positions of lower and upper edge along the ray, m^2
    across_std: F64  # (P, H) standard deviation of the apparent width
    height: F64  # (P, 1)
    height_std: F64  # (P, 1)

    @classmethod
    def of(cls, bearing: F64, mean_m: F64, std_m: F64) -> "_Shape":
        turn = HEADINGS - bearing[:, None]
        cos, sin = np.cos(turn), np.sin(turn)
        length, width, height = mean_m.T[..., None]
        length_std, width_std, height_std = std_m.T[..., None]
        ahead, beside = length / 2 * FORWARD, width / 2 * LEFT
        depth = (length * np.abs(cos) + width * np.abs(sin)) / 2
        by_depth = (SHAPE_SIGMA * depth) ** 2
        by_contact = (CONTACT_SHARE * (np.hypot(length_std * cos, width_std * sin) / 2)) ** 2
        return cls(
            along=ahead * cos - beside * sin,
            aside=ahead * sin + beside * cos,
            depth=depth,
            variances=np.array([by_depth + by_contact, by_depth]),
            across_std=np.hypot(length_std * sin, width_std * cos),
            height=height,
            height_std=height_std,
        )


class _Fit(NamedTuple):
    """The fit of the ranges of P objects to their 2D boxes under each of H headings."""

    step: F64  # (P, H) change of the range's logarithm
    information: F64  # (P, H) of that logarithm
    squared: F64  # (P, H) squared error in standard deviations
    variances: F64  # (P, H) product of the variances
    left: F64  # (P, H) bearing of the leftmost corner from the ray to the centre, radians
    right: F64  # (P, H) the same of the rightmost corner


def place(sightings: Sightings, priors: SizePriors, ground_m: Callable[[F64], F64], noise: Noise) -> Placements:
    """Place the object of each of P 2D boxes; several may show one object.

    Args:
        sightings: The boxes.
        priors: Sizes by class.
        ground_m: Height of the ground at positions (..., 2) of the site.
        noise: Noise of the observations.
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
    xy, covariances = _positions(sightings.origin, range_m, fit, shape, seen, noise)
    return Placements(xy, covariances, -(fit.squared + np.log(fit.variances)) / 2)


def _fit(range_m: F64, first_m: F64, shape: _Shape, seen: Observed, rise_m: Callable[[F64], F64], noise: Noise) -> _Fit:
    """One step of least squares for the logarithm of the range (P, H) of the centre.

    `first_m` (P, H) is the range by the height of the box alone, `rise_m` the height of the ground above the camera at
    ranges (..., P, H).
    """
    # Lower and upper edge: range, height above the camera, and apparent slope.
    nearest_m, roof_m = MIN_RANGE_SHARE * range_m, ROOF_SHARE * shape.depth
    at_m = np.array([np.maximum(range_m - CONTACT_SHARE * shape.depth, nearest_m), range_m])
    above_m = rise_m(at_m)
    above_m[1] += shape.height
    at_m[1] = np.maximum(range_m - np.where(above_m[1] > 0, roof_m, -roof_m), nearest_m)
    edges = above_m / at_m

    ahead_m = np.maximum(range_m + shape.along, nearest_m)
    bearing = np.arctan2(shape.aside, ahead_m)
    turning = -shape.aside / (ahead_m * ahead_m + shape.aside * shape.aside)
    leftmost, rightmost = bearing.argmax(0), bearing.argmin(0)
    left, right = leftmost.choose(bearing), rightmost.choose(bearing)

    # Derivatives of lower edge, upper edge and width by the range's logarithm, and their residuals; twice each.
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
    information, back = information + FIRST_SIGMA**-2, np.log(first_m / range_m) / FIRST_SIGMA
    step, variances = (pull + back / FIRST_SIGMA) / information, determinant * of_width * information
    return _Fit(step, information, squared + back * back, variances, left, right)


def _positions(origin: F64, range_m: F64, fit: _Fit, shape: _Shape, seen: Observed, noise: Noise) -> tuple[F64, F64]:
    """(P, H, 2) centres, metres in the site frame, and (P, H, 2, 2) their covariances.

    A centre is half a width from either side of the 2D box, weighted by their information.
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
