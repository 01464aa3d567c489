"""One object for the sightings of it by several cameras.

Cameras are taken one after another. The sightings of each are assigned to the objects known so far, at most one to an
object, where they are of one class and lie within the gate of their Mahalanobis distance; the others are new objects.
The places of an object are combined for each heading by itself, as independent normal distributions: their information
adds up, and how well they agree says how likely the heading is.
"""

import itertools
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, I64, Indices
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
    length = np.clip(np.hypot(cos, sin), 1e-9, 1.0)
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
    count, objects = len(cameras), np.zeros(len(cameras), np.int64)
    known = _Known(count)
    xy, covariances, _, _ = _means(placements)
    starts = np.flatnonzero(np.diff(cameras, prepend=-1))
    for start, end in itertools.pairwise([*starts.tolist(), count]):
        of_camera = slice(start, end)
        worth = near_worth(
            known.mean_xy[: known.count], known.spread[: known.count], xy[of_camera], covariances[of_camera], GATE
        )
        column_of = columns_of_classes(worth, known.class_ids[: known.count], class_ids[of_camera])
        mine = np.flatnonzero(column_of >= 0)
        theirs = column_of[mine]
        is_new = np.ones(end - start, np.bool_)
        is_new[theirs] = False
        objects[start + theirs] = mine
        fresh = start + np.flatnonzero(is_new)
        objects[fresh] = known.count + np.arange(len(fresh))
        if len(mine):
            known.combine(placements, mine, start + theirs)
        known.append(placements, class_ids, xy, covariances, fresh)
    return objects, known.placements()


class _Known:
    """The objects of the cameras so far, with room for as many as there are sightings.

    Attributes:
        count: Their number N; what stands behind the first N rows means nothing.
        xy: (P, H, 2) as `Placements.xy`.
        covariances: (P, H, 2, 2) as `Placements.covariances`.
        log_weights: (P, H) as `Placements.log_weights`.
        class_ids: (P,) int64.
        mean_xy: (P, 2) mean over all headings.
        spread: (P, 2, 2) its covariance.
    """

    def __init__(self, room: int) -> None:
        self.count, headings = 0, len(HEADINGS)
        self.xy, self.covariances = np.empty((room, headings, 2)), np.empty((room, headings, 2, 2))
        self.log_weights, self.class_ids = np.empty((room, headings)), np.empty(room, np.int64)
        self.mean_xy, self.spread = np.empty((room, 2)), np.empty((room, 2, 2))

    def append(self, placements: Placements, class_ids: I64, mean_xy: F64, spread: F64, rows: Indices) -> None:
        """Rows of sightings of which none is known yet, with their moments."""
        new = slice(self.count, self.count + len(rows))
        self.xy[new], self.covariances[new] = placements.xy[rows], placements.covariances[rows]
        self.log_weights[new], self.class_ids[new] = placements.log_weights[rows], class_ids[rows]
        self.mean_xy[new], self.spread[new] = mean_xy[rows], spread[rows]
        self.count = new.stop

    def combine(self, placements: Placements, rows: Indices, new_rows: Indices) -> None:
        """Known objects with further sightings of them."""
        squares, determinants = combine(
            self.xy, self.covariances, placements.xy, placements.covariances, rows, new_rows
        )
        self.log_weights[rows] += placements.log_weights[new_rows] - (squares + np.log(determinants)) / 2
        changed = Placements(self.xy[rows], self.covariances[rows], self.log_weights[rows])
        self.mean_xy[rows], self.spread[rows], _, _ = _means(changed)

    def placements(self) -> Placements:
        """Of all of them."""
        count = self.count
        return Placements(self.xy[:count], self.covariances[:count], self.log_weights[:count])


def _means(placements: Placements) -> tuple[F64, F64, F64, F64]:
    """(P, 2) means and (P, 2, 2) covariances over all headings; (P,) mean cosine and sine of twice the heading."""
    log_weights = placements.log_weights
    weights = np.exp(log_weights - log_weights.max(1, keepdims=True))
    return mixture_means(weights, placements.xy, placements.covariances, DIRECTIONS)
