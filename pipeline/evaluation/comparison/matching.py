"""Which objects of two results are the same."""

from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64, Array, Bools, Indices
from pipeline.core.geometry.boxes import iou_xyxy, wrap_angle
from pipeline.evaluation.comparison.objects import ImageObjects, SourceObjects
from pipeline.evaluation.records import UNKNOWN

__all__ = ["Matched", "match_boxes", "match_images", "match_places"]

CLASS_COST, LOOKS_COST, ID_GAIN = 0.1, 0.01, 0.1
"""What another class, and the most different heading, size and score cost, and what the same id gains, as shares of the
gate: of objects in one place, those that look alike belong together."""


class Matched(NamedTuple):
    """Rows of one and the same object in both, (M,) each, in the order of the first."""

    first: Indices
    second: Indices


def match_boxes(first: SourceObjects, second: SourceObjects, gates_m: F64) -> Matched:
    """Objects of one source in one frame.

    They are assigned so that the sum of the distances, as shares of the gate, is smallest; who stays alone counts like
    half a gate, so that nobody has to move far to make room. Where an object is counts more than its id, because ids
    are given anew in each run: equal ones bring two objects nearer by a tenth of the gate.

    Args:
        first: N objects.
        second: M objects.
        gates_m: (N, M) how far apart the centres of one object can be.
    """
    a, b = first.found.boxes, second.found.boxes
    ids, other_ids = first.found.track_ids[:, None], second.found.track_ids
    distance = np.linalg.norm(a.centers[:, None] - b.centers, axis=-1) / gates_m
    turned = np.abs(wrap_angle(a.yaws[:, None] - b.yaws)) / np.pi
    sizes, other_sizes = a.sizes[:, None], b.sizes
    resized = np.abs(sizes - other_sizes).max(-1) / np.maximum(np.maximum(sizes, other_sizes).max(-1), 1e-9)
    looks = (turned + resized + _differences(a.scores, b.scores)) / 3
    same_id = (ids == other_ids) & (ids != UNKNOWN)
    return _assigned(distance + CLASS_COST * _other_class(first, second) + LOOKS_COST * looks - ID_GAIN * same_id)


def match_images(first: ImageObjects, second: ImageObjects, min_iou: float) -> Matched:
    """2D boxes of one image, as `match_boxes`, with what their IoU lacks to 1 for a distance."""
    a, b = first.found, second.found
    is_equal = (a.xyxy[:, None] == b.xyxy).all(-1)  # also without an area
    lack = np.where(is_equal, 0.0, 1 - iou_xyxy(a.xyxy, b.xyxy)) / max(1 - min_iou, 1e-9)
    looks = _differences(a.scores, b.scores)
    return _assigned(lack + CLASS_COST * _other_class(first, second) + LOOKS_COST * looks)


def match_places(first: F64, second: F64, gates: F64) -> Matched:
    """Places (N, D) and (M, D) that are less than `gates` (N, M) apart, as `match_boxes`."""
    return _assigned(np.linalg.norm(first[:, None] - second, axis=-1) / gates)


def _other_class(first: SourceObjects | ImageObjects, second: SourceObjects | ImageObjects) -> Bools:
    return np.asarray(first.classes[:, None] != second.classes)


def _differences(first: Array, second: Array) -> F64:
    return np.abs(first.astype(np.float64)[:, None] - second.astype(np.float64))


def _assigned(cost: F64) -> Matched:
    """The assignment of the smallest sum; a pair that costs 1 is no better than none."""
    from scipy.optimize import linear_sum_assignment  # a third of a second: behind the imports of the programs

    rows, columns = linear_sum_assignment(np.minimum(cost, 1.0))
    is_pair = cost[rows, columns] < 1
    return Matched(rows[is_pair], columns[is_pair])
