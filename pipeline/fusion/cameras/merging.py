"""One object for the sightings of it by several cameras.

Cameras are taken one after another. The sightings of each are assigned to the objects known so far, at most one to an
object, where they are of one class and lie within the gate of their Mahalanobis distance; the others are new objects.
The places of an object are combined for each heading by itself, as independent normal distributions: their information
adds up, and how well they agree says how likely the heading is.
"""

from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, I64, Rows, join_rows
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.fusion.assignment import assign
from pipeline.fusion.cameras.placing import HEADINGS, Placements
from pipeline.fusion.small_matrices import inverse

__all__ = ["Moments", "merge_sightings", "moments"]

GATE = 13.8
"""Largest squared Mahalanobis distance of two sightings of one object: 0.1 % of normal errors in a plane are larger."""

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

    def select(self, rows: Rows) -> "Moments":
        """The given rows (mask or indices), in that order."""
        return Moments(*(column[rows] for column in self))


def moments(placements: Placements) -> Moments:
    """The normal distributions nearest to these mixtures over the headings."""
    weights = np.exp(placements.log_weights - placements.log_weights.max(1, keepdims=True))
    weights /= weights.sum(1, keepdims=True)
    xy = (weights[..., None] * placements.xy).sum(1)
    gap = placements.xy - xy[:, None]
    spread = placements.covariances + gap[..., :, None] * gap[..., None, :]
    covariances = np.zeros((len(xy), 3, 3))
    covariances[:, :2, :2] = (weights[..., None, None] * spread).sum(1)
    # An axis has no front: the mean is taken of twice its angle.
    cos, sin = (weights * np.cos(2 * HEADINGS)).sum(1), (weights * np.sin(2 * HEADINGS)).sum(1)
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
    objects = np.zeros(len(cameras), np.int64)
    known, known_class = placements.select(np.zeros(0, np.int64)), np.zeros(0, np.int64)
    alone = moments(placements)
    for camera in np.unique(cameras):
        rows = np.flatnonzero(cameras == camera)
        new = placements.select(rows)
        mine, theirs = _assign(known, known_class, alone.select(rows), class_ids[rows])
        if len(mine):
            known = _combined(known, mine, new.select(theirs))
        fresh = np.delete(np.arange(len(rows)), theirs)
        objects[rows[theirs]] = mine
        objects[rows[fresh]] = len(known_class) + np.arange(len(fresh))
        known = join_rows(known, new.select(fresh))
        known_class = np.concatenate([known_class, class_ids[rows[fresh]]])
    return objects, known


def _assign(known: Placements, known_class: I64, new: Moments, new_class: I64) -> tuple[I64, I64]:
    """Rows of known objects and the rows of new sightings of them, which are of one class."""
    mine, theirs = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    common = np.intersect1d(known_class, new_class)
    if not len(common):
        return mine[0], theirs[0]
    worth = np.maximum(GATE - _squared_distances(moments(known), new), 0.0)
    for class_id in common:
        rows, columns = np.flatnonzero(known_class == class_id), np.flatnonzero(new_class == class_id)
        near = worth[rows[:, None], columns]
        a, b = assign(-near)
        taken = near[a, b] > 0
        mine.append(rows[a[taken]])
        theirs.append(columns[b[taken]])
    return np.concatenate(mine), np.concatenate(theirs)


def _squared_distances(first: Moments, second: Moments) -> F64:
    """(R, C) squared Mahalanobis distances of places, each as uncertain as both together."""
    x, y = (second.xy[:, axis] - first.xy[:, axis, None] for axis in range(2))
    a, b, c = (first.covariances[:, None, i, j] + second.covariances[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    return np.asarray((c * x * x - 2 * b * x * y + a * y * y) / (a * c - b * b))


def _combined(known: Placements, rows: I64, new: Placements) -> Placements:
    """The known places, those of `rows` combined with the new ones."""
    p, q = known.covariances[rows], new.covariances
    total = p + q
    gap = new.xy - known.xy[rows]
    weight = inverse(total)
    gain = (p[..., :, :, None] * weight[..., None, :, :]).sum(-2)
    moved = (gain * gap[..., None, :]).sum(-1)
    square = (gap[..., :, None] * weight * gap[..., None, :]).sum((-1, -2))
    determinant = total[..., 0, 0] * total[..., 1, 1] - total[..., 0, 1] ** 2
    left = p - (gain[..., :, :, None] * p[..., None, :, :]).sum(-2)
    xy, covariances, log_weights = known.xy.copy(), known.covariances.copy(), known.log_weights.copy()
    xy[rows] += moved
    covariances[rows] = (left + left.swapaxes(-1, -2)) / 2
    log_weights[rows] += new.log_weights - (square + np.log(determinant)) / 2
    return Placements(xy, covariances, log_weights)
