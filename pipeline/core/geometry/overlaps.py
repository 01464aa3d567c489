"""Boxes that stand on the same ground, and so are one object."""

from collections.abc import Iterator

import numpy as np

from lidcam.pipeline.core.arrays import F64, Indices
from lidcam.pipeline.core.geometry.rotated_iou import BoxArrays, OrientedBoxes, ious, shared_ground

OVERLAP_SHARE = 0.25
"""Largest share of a box's ground inside another box; with more, both are taken for one object."""

BLOCK_BOXES = 256
"""Boxes whose neighbours are sought at once: a cloud may hold many small clusters."""


def without_overlaps(boxes: OrientedBoxes, groups: Indices | None = None) -> Indices:
    """Rows of the boxes, the better ones first, that share little ground with any box kept before them.

    With `groups` (N,), what each box belongs to, only boxes of different groups are compared.
    """
    kept = np.ones(len(boxes.yaws), np.bool_)
    for first, second in _rivals(boxes):
        if groups is not None:
            is_other = groups[first] != groups[second]
            first, second = first[is_other], second[is_other]
        rows, starts = np.unique(first, return_index=True)  # they come together
        for row, others in zip(rows.tolist(), np.split(second, starts[1:]), strict=False):  # of none, one empty part
            kept[row] = not kept[others].any()
    return np.flatnonzero(kept)


def overlap_shares(first: OrientedBoxes, second: OrientedBoxes, bev: F64 | None = None) -> F64:
    """(N, M) ground shared by each of N boxes with each of M, as a share of the smaller one's; `bev` if known."""
    bev = ious(first, second).bev if bev is None else bev
    ground_m2, others_m2 = (boxes.sizes[:, 0] * boxes.sizes[:, 1] for boxes in (first, second))
    shared_m2 = bev / (1 + bev) * (ground_m2[:, None] + others_m2)
    return np.asarray(shared_m2 / np.maximum(np.minimum(ground_m2[:, None], others_m2), 1e-12))


def _rivals(boxes: OrientedBoxes) -> Iterator[tuple[Indices, Indices]]:
    """Boxes, and one before each of them, of which one has too much of its ground inside the other; in their order."""
    count = len(boxes.yaws)
    if not count:
        return
    places, ground_m2 = boxes.centers[:, :2], boxes.sizes[:, 0] * boxes.sizes[:, 1]
    reach_m = np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2
    # Neighbours along the axis on which the boxes lie furthest apart.
    along_m = places[:, np.argmax(np.ptp(places, axis=0))]
    order = np.argsort(along_m, kind="stable")
    sorted_m = along_m[order]
    for start in range(0, count, BLOCK_BOXES):
        rows = np.arange(start, min(start + BLOCK_BOXES, count))
        largest_m = (reach_m[rows] + reach_m.max()) * (1 + 1e-9)
        begins = np.searchsorted(sorted_m, along_m[rows] - largest_m)
        counts = np.searchsorted(sorted_m, along_m[rows] + largest_m, side="right") - begins
        first = np.repeat(rows, counts)
        second = order[np.arange(len(first)) + np.repeat(begins - np.cumsum(counts) + counts, counts)]
        is_before = second < first
        first, second = first[is_before], second[is_before]
        gap = places[first] - places[second]
        is_near = np.hypot(gap[:, 0], gap[:, 1]) <= reach_m[first] + reach_m[second]
        first, second = first[is_near], second[is_near]
        shared_m2 = shared_ground(BoxArrays.of(boxes, first), BoxArrays.of(boxes, second))
        is_rival = shared_m2 > OVERLAP_SHARE * np.minimum(ground_m2[first], ground_m2[second])
        yield first[is_rival], second[is_rival]
