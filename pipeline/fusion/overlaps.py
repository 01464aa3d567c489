"""Boxes that stand on the same ground, and so are one object."""

import numpy as np

from pipeline.core.arrays import F64, Bools
from pipeline.core.geometry.rotated_iou import OrientedBoxes, ious

__all__ = ["first_of_each", "overlap_shares"]


def overlap_shares(first: OrientedBoxes, second: OrientedBoxes, bev: F64 | None = None) -> F64:
    """(N, M) ground that each of N boxes shares with each of M, as a share of that of the smaller one.

    Args:
        first: N boxes.
        second: M boxes.
        bev: (N, M) their `Ious.bev`, where it is known already.
    """
    bev = ious(first, second).bev if bev is None else bev
    ground_m2, others_m2 = (boxes.sizes[:, 0] * boxes.sizes[:, 1] for boxes in (first, second))
    shared_m2 = bev / (1 + bev) * (ground_m2[:, None] + others_m2)
    return np.asarray(shared_m2 / np.maximum(np.minimum(ground_m2[:, None], others_m2), 1e-12))


def first_of_each(boxes: OrientedBoxes, share: float) -> Bools:
    """(N,) whether each box shares no more than a part of its ground with any kept one before it.

    Args:
        boxes: The better ones first.
        share: Of the ground of the smaller of two boxes.
    """
    rivals = np.tril(overlap_shares(boxes, boxes) > share, -1)
    kept = np.ones(len(rivals), np.bool_)
    for row in np.flatnonzero(rivals.any(1)):
        kept[row] = not (rivals[row] & kept).any()
    return kept
