"""Oriented rectangles around clusters seen from above, by search over the heading.

A lidar sees the near sides of a car: an L, or one line. The heading chosen is the one at which the points lie closest
to the sides of their bounding rectangle (X. Zhang, W. Xu, C. Dong, J. M. Dolan: Efficient L-shape fitting for vehicle
detection using laser scanners, IEEE Intelligent Vehicles Symposium 2017; closeness criterion). Unlike there, all four
sides count, because several lidars may see them all, and a small share of the points may lie outside, such as mirrors
and stray points. All clusters are fitted at once.

Of points (N, 2 or more), x and y count, metres; they are sorted by cluster, and `starts` (C,) are the first rows of the
clusters. There is at least one cluster, and each has at least one point.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.native.kernels import closest_directions, quantiles, rectangles

COARSE_STEP_DEG = 3.0
FINE_STEP_DEG = 0.5

OUTSIDE_SHARE = 0.01
"""Maximum share of the points outside at each side of the final rectangle."""

_COARSE_RAD = np.deg2rad(np.arange(0.0, 90.0, COARSE_STEP_DEG))
_FINE_RAD = np.deg2rad(np.arange(-COARSE_STEP_DEG, COARSE_STEP_DEG + FINE_STEP_DEG / 2, FINE_STEP_DEG))
_ANGLES_RAD = np.append(_COARSE_RAD, _COARSE_RAD[:, None] + _FINE_RAD)
_COS, _SIN = np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)
"""The directions that are tried: coarse ones, then the fine ones about each of these in turn."""


@dataclass(frozen=True, eq=False)
class Rectangles:
    """Bounding rectangles of C clusters, seen from above."""

    angle_rad: F64  # (C,) float64 angle of the first axis about +z, in [0, pi/2)
    low: F64  # (C, 2) float64 lower ends along the first and second axis (rotated coordinates), metres
    high: F64  # (C, 2) float64 upper ends, metres
    residual_m: F64  # (C,) float64 root mean square distance of the points from their nearest sides


def fit_rectangles(xy: F64, starts: I64) -> Rectangles:
    """Fit a rectangle to each cluster."""
    xy, ends = np.ascontiguousarray(xy), _ends_of(starts, len(xy))
    low = np.minimum.reduceat(xy[:, :2], starts)
    diagonal_m = np.maximum(np.hypot(*(np.maximum.reduceat(xy[:, :2], starts) - low).T), 1e-3)
    best = closest_directions(xy, ends, low, diagonal_m, _COS, _SIN, len(_COARSE_RAD))
    return rectangles_along(xy, starts, _ANGLES_RAD.take(best))


def rectangles_along(xy: F64, starts: I64, angles_rad: F64) -> Rectangles:
    """The rectangle around each cluster with a side in a given direction (C,), about +z."""
    angle = np.mod(angles_rad, np.pi / 2)
    ends = _ends_of(starts, len(xy))
    return Rectangles(angle, *rectangles(np.ascontiguousarray(xy), ends, np.cos(angle), np.sin(angle), OUTSIDE_SHARE))


def quantiles_by_cluster(values: F64, starts: I64, share: float) -> F64:
    """(C,) a quantile of each cluster's values (N,).

    It is rounded outwards to the next value, so that a cluster of few points loses none of its extent.
    """
    return quantiles(np.ascontiguousarray(values), _ends_of(starts, len(values)), share)


def principal_axes(xy: F64, starts: I64) -> tuple[F64, F64]:
    """(C,) angle about +z of the principal axis of each cluster, in (-pi/2, pi/2]; (C,) its roundness, in [0, 1].

    The principal axis is the direction in which points are spread most. A cyclist is no rectangle: thin wheels at both
    ends, a rider as wide as the handlebars in the middle. The rectangle to whose sides the points lie closest runs
    along the lines from shoulder to wheel, 14 degrees off the heading in the median of simulated recordings; the
    principal axis is 3 degrees off. Roundness is the standard deviation across the axis, as a share of that along it;
    1 for a single point.
    """
    counts = np.diff(starts, append=len(xy))
    mean = np.add.reduceat(xy[:, :2], starts) / counts[:, None]
    x, y = (xy[:, :2] - np.repeat(mean, counts, axis=0)).T
    xx, xy_, yy = np.add.reduceat(np.stack([x * x, x * y, y * y]), starts, axis=1) / counts
    apart = np.hypot((xx - yy) / 2, xy_)
    largest, smallest = (xx + yy) / 2 + apart, np.maximum((xx + yy) / 2 - apart, 0.0)
    roundness = np.sqrt(np.divide(smallest, largest, out=np.ones_like(largest), where=largest > 0))
    return np.arctan2(2 * xy_, xx - yy) / 2, roundness


def _ends_of(starts: I64, count: int) -> I64:
    """(C,) row behind the last of each cluster."""
    return np.append(starts[1:], count)
