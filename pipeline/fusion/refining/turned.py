"""Boxes whose heading is not known, fitted once more from the heading at right angles.

Of a rider of whom the lidars see little more than the shoulders, nobody knows whether the points lie along the bicycle
or across it. The images do: the box and the turned box are both fitted to them, and the one is taken that explains them
better.
"""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import I64, Bools, first_of_runs
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.fusion.refining.box_prior import MAX_YAW_RAD, SQUARE
from pipeline.fusion.refining.edges import MeasuredEdges
from pipeline.fusion.refining.refinement import RefinedBoxes

__all__ = ["better_turned", "with_turned"]

EITHER_YAW_RAD = np.pi / 2 / np.sqrt(12.0)
"""Standard deviation of a heading of which it is known that it is no farther than an eighth of a turn away."""

TURNED_SHARE = 0.3
"""Share of the boxes of unknown heading that are turned by more than an eighth: 32 of 111 cyclists in three simulated
recordings."""

TURNED_COST = 2 * np.log(1 / TURNED_SHARE - 1)


def with_turned(boxes: Boxes3D, edges: MeasuredEdges) -> tuple[Boxes3D, MeasuredEdges, I64]:
    """The boxes, and once more, turned, those with a 2D box that are longer than wide and of unknown heading.

    Args:
        boxes: N boxes.
        edges: Their pairs.

    Returns:
        N + T boxes, the pairs of all of them, and (N + T,) the row of the given box that each stands for.
    """
    own = np.arange(len(boxes))
    is_long = boxes.sizes[:, 0] > SQUARE * boxes.sizes[:, 1]
    is_unknown = is_long & (boxes.covariances[:, 2, 2] > MAX_YAW_RAD**2)
    if is_unknown.any():
        is_unknown &= np.bincount(edges.rows, minlength=len(boxes)) > 0
    unknown = np.flatnonzero(is_unknown)
    if not len(unknown):
        return boxes, edges, own
    covariances = boxes.covariances.copy()
    share = EITHER_YAW_RAD / np.sqrt(covariances[unknown, 2, 2])
    covariances[unknown, 2] *= share[:, None]
    covariances[unknown, :, 2] *= share[:, None]
    either = replace(boxes, covariances=covariances)
    turned = either.select(unknown)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        turned,
        yaws=wrap_angle(turned.yaws + np.pi / 2),
        covariances=quarter @ turned.covariances @ quarter.T,
    )
    again = np.flatnonzero(is_unknown[edges.rows])
    number = len(boxes) + np.searchsorted(unknown, edges.rows[again])
    rows = np.concatenate([edges.rows, number]).astype(np.int64)
    edges = replace(edges.select(np.concatenate([np.arange(len(edges)), again])), rows=rows)
    return either.joined(turned), edges, np.concatenate([own, unknown])


def better_turned(objects: I64, found: RefinedBoxes, turned_of: I64) -> Bools:
    """(M,) whether each fitted box is likelier than the other one that stands for the same box.

    Of two that are equally likely it is the one that is not turned.

    Args:
        objects: (M,) row of each in what `with_turned` gives, rising.
        found: The M fitted boxes.
        turned_of: See there.
    """
    stands_for = turned_of[objects]
    is_turned = stands_for != objects
    if not is_turned.any():
        return np.ones(len(objects), np.bool_)
    costs = np.where(found.accepted, found.costs + TURNED_COST * is_turned, np.inf)
    order = np.lexsort((objects, costs, stands_for))
    better = np.zeros(len(objects), np.bool_)
    better[order[first_of_runs(stands_for[order])]] = True
    return better
