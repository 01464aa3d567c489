"""Average precisions of a class, and of all classes.

`by_criterion` are the detections of a class that count, by column of the criterion; `count` the true objects of the
class in a part of the site.
"""

from collections.abc import Callable, Sequence

import numpy as np

from lidcam.pipeline.evaluation.detection.criteria import DISTANCES_M, Criteria
from lidcam.pipeline.evaluation.detection.curves import average_precision, curve_of, interpolated_ap
from lidcam.pipeline.evaluation.detection.tables import Scored
from lidcam.pipeline.evaluation.scales import decimal

Averages = dict[str, float | None]


def ap_by_distance_name(limit_m: float) -> str:
    """Name of the average precision at one of `DISTANCES_M`."""
    return f"ap_{decimal(limit_m)}"


_AP_NAMES = tuple(map(ap_by_distance_name, DISTANCES_M))


def overlap_name(iou: float) -> str:
    """End of a figure's name for an IoU: 0.5 is `50`."""
    return decimal(100 * iou)


def overlap_figures(criteria: Criteria, by_criterion: Callable[[int], Scored], count: int) -> Averages:
    """Average precision at each IoU, seen from above and in 3D."""
    figures: Averages = {}
    for view, column_of in (("bev", criteria.bev_column), ("3d", criteria.volume_column)):
        for iou in criteria.ious:
            detections = by_criterion(column_of(iou))
            curve = curve_of(detections.scores, detections.is_right, count)
            figures[f"ap_{view}_r40_{overlap_name(iou)}"] = average_precision(curve.right, curve.precision, count)
    return figures


def distance_figures(criteria: Criteria, by_criterion: Callable[[int], Scored], count: int) -> Averages:
    """Average precision by distance, scaled to the class, and its mean."""
    if not count:
        return dict.fromkeys(("map", *_AP_NAMES))
    precisions = [interpolated_ap(by_criterion(column).is_right, count) for column in criteria.distance_columns]
    return {"map": float(np.mean(precisions)), **dict(zip(_AP_NAMES, precisions, strict=True))}


def mean_figures(classes: Sequence[Averages]) -> Averages:
    """The mean of each figure over the classes where it is defined."""
    return {name: _mean([figures[name] for figures in classes]) for name in classes[0]}


def _mean(values: Sequence[float | None]) -> float | None:
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else None
