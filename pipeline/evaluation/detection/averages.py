"""Average precisions of a class, and of all classes.

`by_criterion` are the detections of a class that count, by column of the criterion; `found` all detections of the
source; `count` the true objects of the class in a part of the site.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.evaluation.detection.criteria import DISTANCES_M, Criteria
from lidcam.pipeline.evaluation.detection.curves import (
    average_precision,
    curve_of,
    interpolated_ap,
    last_of_equals,
    mean_errors,
    points_of,
)
from lidcam.pipeline.evaluation.detection.errors import Column, bird_eye_m
from lidcam.pipeline.evaluation.detection.tables import FoundTable, Scored, TruthTable
from lidcam.pipeline.evaluation.scales import decimal

Averages = dict[str, float | None]

_AP_WEIGHT = 5.0
"""Weight of the mean average precision in a detection score; each error weighs 1."""


def ap_by_distance_name(limit_m: float) -> str:
    """Name of the average precision at one of `DISTANCES_M`."""
    return f"ap_{decimal(limit_m)}"


_AP_NAMES = tuple(map(ap_by_distance_name, DISTANCES_M))


def overlap_name(iou: float) -> str:
    """End of a figure's name for an IoU: 0.5 is `50`."""
    return decimal(100 * iou)


def overlap_figures(
    criteria: Criteria, by_criterion: Callable[[int], Scored], found: FoundTable, truth: TruthTable, count: int
) -> Averages:
    """Average precision at each IoU, seen from above and in 3D, and orientation similarity."""
    figures: Averages = {}
    for view, column_of in (("bev", criteria.bev_column), ("3d", criteria.volume_column)):
        for iou in criteria.ious:
            detections = by_criterion(column_of(iou))
            curve = curve_of(detections.scores, detections.is_right, count)
            figures[f"ap_{view}_r40_{overlap_name(iou)}"] = average_precision(curve.right, curve.precision, count)
    for iou in criteria.ious:
        similarity = _orientation_similarity(by_criterion(criteria.bev_column(iou)), found, truth, count)
        figures[f"aos_bev_r40_{overlap_name(iou)}"] = similarity
    return figures


def _orientation_similarity(detections: Scored, found: FoundTable, truth: TruthTable, count: int) -> float | None:
    # (1 + cos d) / 2 in place of each right detection: Geiger et al., Are we ready for autonomous driving? The KITTI
    # vision benchmark suite, CVPR 2012, section 3.4
    right = detections.is_right
    turn = found.yaws[detections.rows[right]].astype(np.float64) - truth.yaws[detections.truth_rows[right]]
    similarity = np.zeros(len(detections))
    similarity[right] = (1 + np.cos(turn)) / 2
    last = last_of_equals(detections.scores)
    quality = np.cumsum(similarity)[last] / (last + 1)
    return average_precision(np.cumsum(right, dtype=np.int64)[last], quality, count)


def distance_figures(
    criteria: Criteria, by_criterion: Mapping[int, Scored], found: FoundTable, count: int, scale: float
) -> Averages:
    """Average precision by distance, and errors, with distances scaled to the class.

    In the score, the error of position is divided by the same scale.
    """
    if not count:
        return dict.fromkeys(("map", *_AP_NAMES, "translation_m", "scale", "orientation_deg", "score"))
    precisions = [_ap(by_criterion[column], count) for column in criteria.distance_columns]
    errors = _mean_errors(criteria, by_criterion, found, count)
    mean = float(np.mean(precisions))
    figures: Averages = {"map": mean, **dict(zip(_AP_NAMES, precisions, strict=True))}
    names = ("translation_m", "scale", "orientation_deg")
    if errors is None:
        return {**figures, **dict.fromkeys(names), "score": detection_score(mean, (1.0, 1.0, 1.0))}
    translation_m, size, turn = map(float, errors)
    figures |= dict(zip(names, (translation_m, size, float(np.degrees(turn))), strict=True))
    return {**figures, "score": detection_score(mean, (translation_m / scale, size, turn))}


def detection_score(mean_ap: float, errors: Sequence[float]) -> float:
    """Weighted mean of an average precision and of 1 - error for each error; an error above 1 counts as 1."""
    scores = sum(max(0.0, 1.0 - error) for error in errors)
    return (_AP_WEIGHT * mean_ap + scores) / (_AP_WEIGHT + len(errors))


def _ap(detections: Scored, count: int) -> float:
    return interpolated_ap(*points_of(detections.is_right, count))


def _mean_errors(criteria: Criteria, by_criterion: Mapping[int, Scored], found: FoundTable, count: int) -> F64 | None:
    detections = by_criterion[criteria.position_column]
    errors = found.errors[detections.rows[detections.is_right]].astype(np.float64)
    columns = np.column_stack([bird_eye_m(errors), errors[:, Column.SCALE], np.abs(errors[:, Column.YAW])])
    return mean_errors(columns, detections.scores, detections.is_right, count)


def mean_figures(classes: Sequence[Averages]) -> Averages:
    """The mean of each figure over the classes where it is defined."""
    return {name: _mean([figures[name] for figures in classes]) for name in classes[0]}


def _mean(values: Sequence[float | None]) -> float | None:
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else None
