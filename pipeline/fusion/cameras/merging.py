"""One object for the sightings of it by several cameras.

Cameras are taken one after another. The sightings of each are assigned to the objects known so far, at most one to an
object, where they are of one class and lie within the gate of their Mahalanobis distance; the others are new objects.
The places of an object are combined for each heading by itself, as independent normal distributions: their information
adds up, and how well they agree says how likely the heading is.
"""

import itertools
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, I64, Indices, first_of_runs
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.fusion.assignment_kernels import columns_of_classes
from pipeline.fusion.cameras.merging_kernels import combine, mixture_means, near_worth
from pipeline.fusion.cameras.placing import HEADINGS, Placements

__all__ = ["Moments", "merge_sightings", "moments"]

GATE = 13.8
"""Largest squared Mahalanobis distance of two sightings of one object: 0.1 % of normal errors in a plane are larger."""

DIRECTIONS = np.stack([np.cos(2 * HEADINGS), np.sin(2 * HEADINGS)])
"""Of twice the headings."""

MAX_YAW_VARIANCE = np.pi**2 / 12
"""Of an axis of which nothing is known, rad^2."""


class Moments(NamedTuple):
    """Means and covariances of placements over all headings.

    Attributes:
        xy: (P, 2) float64 centre, metres in the site frame.
        yaw_rad: (P,) float64 mean axis, in (-pi/2, pi/2].
        covariances: (P, 3, 3) float64 over x, y (m^2) and yaw (rad^2).
    """

    xy: F64
    yaw_rad: F64
    covariances: F64


def moments(placements: Placements) -> Moments:
    """The normal distributions nearest to these mixtures over the headings."""
    xy, spread, cos, sin = _means(placements)
    covariances = np.zeros((len(xy), 3, 3))
    covariances[:, :2, :2] = spread
    # An axis has no front: the mean is taken of twice its angle.
    length = np.hypot(cos, sin).clip(1e-9, 1.0)
    covariances[:, 2, 2] = np.minimum(-np.log(length) / 2, MAX_YAW_VARIANCE) + (HEADINGS[1] ** 2) / 12
    return Moments(xy, wrap_angle(np.arctan2(sin, cos)) / 2, covariances)


def merge_sightings(placements: Placements, cameras: I64, class_ids: I64) -> tuple[I64, Placements]:
    """The objects behind the sightings of all cameras.

    Args:
        placements: Of P sightings, camera after camera.
        cameras: (P,) camera of each, in rising order.
        class_ids: (P,) class of each.

    Returns:
        (P,) the object of each sighting, numbered in order of their first one; and the places of the objects.
    """
    count = len(cameras)
    known = _Known(placements)
    mean_xy, spread = known.mean_xy.copy(), known.spread.copy()
    first, is_first = np.arange(count), np.ones(count, np.bool_)
    for start, end in itertools.pairwise([*first_of_runs(cameras).nonzero()[0].tolist(), count]):
        objects, own = is_first[:start].nonzero()[0], slice(start, end)
        worth = near_worth(known.mean_xy[objects], known.spread[objects], mean_xy[own], spread[own], GATE)
        column_of = columns_of_classes(worth, class_ids[objects], class_ids[own])
        matched = (column_of >= 0).nonzero()[0]
        if len(matched):
            rows, new_rows = objects[matched], start + column_of[matched]
            first[new_rows], is_first[new_rows] = rows, False
            known.combine(placements, rows, new_rows)
    return (np.cumsum(is_first) - 1)[first], known.placements.select(is_first)


class _Known:
    """What the cameras so far say of the object of each sighting, in the row of its first one.

    Attributes:
        placements: (P) where the objects stand.
        mean_xy: (P, 2) mean over all headings.
        spread: (P, 2, 2) its covariance.
    """

    def __init__(self, placements: Placements) -> None:
        copies = placements.xy.copy(), placements.covariances.copy(), placements.log_weights.copy()
        self.placements = Placements(*copies)
        self.mean_xy, self.spread, _, _ = _means(placements)

    def combine(self, new: Placements, rows: Indices, new_rows: Indices) -> None:
        """Known objects with further sightings of them."""
        known = self.placements
        squares, determinants = combine(known.xy, known.covariances, new.xy, new.covariances, rows, new_rows)
        known.log_weights[rows] += new.log_weights[new_rows] - (squares + np.log(determinants)) / 2
        self.mean_xy[rows], self.spread[rows], _, _ = _means(known.select(rows))


def _means(placements: Placements) -> tuple[F64, F64, F64, F64]:
    """(P, 2) means and (P, 2, 2) covariances over all headings; (P,) mean cosine and sine of twice the heading."""
    log_weights = placements.log_weights
    weights = np.exp(log_weights - log_weights.max(1, keepdims=True))
    return mixture_means(weights, placements.xy, placements.covariances, DIRECTIONS)
