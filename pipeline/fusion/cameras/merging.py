"""Merges the sightings of an object by several cameras.

Cameras are taken one after another. The sightings of each are assigned to the objects so far, at most one to an object,
if they are of one class and within a gate of their Mahalanobis distance; the others are new objects. The positions of
an object are combined for each heading separately, as independent normal distributions: their information adds up, and
their agreement gives the likelihood of the heading.
"""

import itertools
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Indices, first_of_runs
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.detectors.log_odds import softmax
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.cameras.placing import HEADINGS, Placements

MAX_DISTANCE = 13.8
"""Maximum squared Mahalanobis distance of two sightings of one object; 0.1 % of normal errors in a plane exceed it."""

DIRECTIONS = np.stack([np.cos(2 * HEADINGS), np.sin(2 * HEADINGS)], 1)
"""(H, 2) unit vectors of twice the headings."""

MAX_YAW_VARIANCE = np.pi**2 / 12
"""Variance of an unknown axis, rad^2."""

VIEW_WEIGHT = 1e-3
"""Weight of the direction of view, against 1 for all headings, where these cancel out: among equally likely headings,
as of a footprint as long as wide, rounding alone would decide their mean."""

QUARTER_RAD = np.pi / 2 - 1e-6
"""Maximum clockwise angle of an axis with a negative yaw, so that an axis along y has one yaw however it is rounded."""


class Moments(NamedTuple):
    """Means and covariances of placements over all headings."""

    xy: F64  # (P, 2) float64 centre, metres in the site frame
    yaw_rad: F64  # (P,) float64 mean axis, in (-pi/2, pi/2] but for rounding; the direction of view if unknown
    covariances: F64  # (P, 3, 3) float64 over x, y (m^2) and yaw (rad^2)


def moments(placements: Placements, view_xy: F64) -> Moments:
    """The normal distributions nearest to the mixtures of P objects over the headings.

    `view_xy` (P, 2) is the position of a camera that sees each, metres in the site frame.
    """
    xy, spread = mean_places(placements)
    covariances = np.zeros((len(xy), 3, 3))
    covariances[:, :2, :2] = spread
    # An axis has no front: the mean is taken of twice its angle.
    mean = softmax(placements.log_weights) @ DIRECTIONS
    length = np.hypot(mean[:, 0], mean[:, 1]).clip(1e-9, 1.0)
    covariances[:, 2, 2] = np.minimum(-np.log(length) / 2, MAX_YAW_VARIANCE) + (HEADINGS[1] ** 2) / 12
    view_rad = 2 * np.arctan2(xy[:, 1] - view_xy[:, 1], xy[:, 0] - view_xy[:, 0])
    view_weight = VIEW_WEIGHT * (1 - length)
    mean += view_weight[:, None] * np.stack([np.cos(view_rad), np.sin(view_rad)], 1)
    yaw_rad = np.arctan2(mean[:, 1], mean[:, 0]) / 2
    return Moments(xy, wrap_angle(yaw_rad + np.pi * (yaw_rad < -QUARTER_RAD)), covariances)


def mean_places(placements: Placements) -> tuple[F64, F64]:
    """(P, 2) means and (P, 2, 2) covariances of the centres over all headings, metres in the site frame."""
    shares = softmax(placements.log_weights)[..., None]
    mean = (shares * placements.xy).sum(1)
    gaps = placements.xy - mean[:, None]
    spread = placements.covariances + gaps[..., None] * gaps[..., None, :]
    return mean, (shares[..., None] * spread).sum(1)


def merge_sightings(placements: Placements, cameras: I64, class_ids: I64) -> tuple[I64, Placements]:
    """The objects behind the sightings of all cameras.

    Args:
        placements: Placements of P sightings, camera after camera.
        cameras: (P,) camera of each, rising.
        class_ids: (P,) class of each.

    Returns:
        (P,) the object of each sighting, numbered by first sighting; placements of the objects.
    """
    count = len(cameras)
    first, is_first = np.arange(count), np.ones(count, np.bool_)
    # A copy: the row of an object's first sighting holds its placement by the cameras so far.
    known, (mean_xy, spread) = placements.select(first), mean_places(placements)
    _, *starts = *first_of_runs(cameras).nonzero()[0].tolist(), count
    for start, end in itertools.pairwise(starts):  # all of the first camera are new
        objects, new = is_first[:start].nonzero()[0], np.arange(start, end)
        gap = mean_xy[new] - mean_xy[objects, None]
        inverse, _ = _inverse(spread[objects, None] + spread[new])
        worth = np.maximum(MAX_DISTANCE - _squared(gap, inverse), 0.0)  # margin to the gate
        worth[class_ids[objects][:, None] != class_ids[new]] = 0.0
        row, column = assign(-worth)
        is_one = worth[row, column] > 0
        rows, new_rows = objects[row[is_one]], new[column[is_one]]
        if len(rows):
            first[new_rows], is_first[new_rows] = rows, False
            _combine(known, rows, new_rows)
            mean_xy[rows], spread[rows] = mean_places(known.select(rows))
    return (np.cumsum(is_first) - 1)[first], known.select(is_first)


def _combine(known: Placements, rows: Indices, new_rows: Indices) -> None:
    """Combine placements, in place, with independent other ones, under each heading."""
    gap, covariances = known.xy[new_rows] - known.xy[rows], known.covariances[rows]
    inverse, determinant = _inverse(covariances + known.covariances[new_rows])
    a, b, c = inverse
    gain = covariances @ np.stack([a, b, b, c], -1).reshape(covariances.shape)
    known.xy[rows] += (gain * gap[..., None, :]).sum(-1)
    left = covariances - gain @ covariances
    known.covariances[rows] = (left + left.swapaxes(-1, -2)) / 2
    known.log_weights[rows] += known.log_weights[new_rows] - (_squared(gap, inverse) + np.log(determinant)) / 2


def _inverse(matrices: F64) -> tuple[F64, F64]:
    """(3, ...) xx, xy, yy of the inverses of symmetric matrices (..., 2, 2), (...) their determinants; beats LAPACK."""
    a, b, c = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    determinant = a * c - b * b
    return np.array([c, -b, a]) / determinant, determinant


def _squared(gap: F64, inverse: F64) -> F64:
    """(...) squares of vectors (..., 2) by inverse covariances (3, ...), see `_inverse`."""
    (x, y), (a, b, c) = (gap[..., 0], gap[..., 1]), inverse
    return np.asarray(x * x * a + 2 * x * y * b + y * y * c)
