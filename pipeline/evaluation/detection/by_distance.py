"""Average precision and errors as nuScenes has them: by distance of the centres, at 101 recalls.

Caesar et al., nuScenes: a multimodal dataset for autonomous driving, CVPR 2020, section 3.1; where the paper leaves
something open, as its devkit does it.
"""

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import F32, F64, Bools

__all__ = ["interpolated_ap", "mean_errors", "points_of"]

_RECALLS = np.linspace(0, 1, 101)
_MIN_PRECISION = 0.1
_FIRST = 11
"""Row of the first recall above 0.1."""


def interpolated_ap(recall: F64, precision: F64) -> float:
    """Mean precision beyond 0.1 at the recalls above 0.1, as a share of what it can be at most.

    Args:
        recall: (P,) not falling; one point for each detection, by falling score.
        precision: (P,) at each point.

    Returns:
        In [0, 1]; 0 without points.
    """
    if not len(recall):
        return 0.0
    read = np.interp(_RECALLS, recall, precision, right=0)[_FIRST:]
    return float(np.maximum(read - _MIN_PRECISION, 0).mean() / (1 - _MIN_PRECISION))


def points_of(is_right: Bools, truth: int) -> tuple[F64, F64]:
    """Recall and precision (N,) after each detection, by falling score.

    Args:
        is_right: (N,) by falling score.
        truth: True objects, at least one.
    """
    right = np.cumsum(is_right)
    return right / truth, right / np.arange(1, len(right) + 1)


def mean_errors(errors: npt.NDArray[np.floating], scores: F32, is_right: Bools, truth: int) -> F64 | None:
    """Mean errors over the recalls above 0.1 that are reached, of the means of all detections up to each recall.

    Args:
        errors: (R, E) errors of the right detections, by falling score.
        scores: (N,) of all detections, falling.
        is_right: (N,) R of them are true.
        truth: True objects.

    Returns:
        (E,); None if no recall above 0.1 is reached.
    """
    if not truth or not len(errors):
        return None
    recall, _ = points_of(is_right, truth)
    # the scores at the recalls are 0 beyond the last one that is reached, and where detections score 0
    at_recalls = np.interp(_RECALLS, recall, scores.astype(np.float64), right=0)
    last = int(np.max(np.flatnonzero(at_recalls), initial=0))
    if last < _FIRST:
        return None
    means = np.cumsum(errors.astype(np.float64), axis=0) / np.arange(1, len(errors) + 1)[:, None]
    rising = scores[is_right].astype(np.float64)[::-1]
    read = [np.interp(at_recalls[_FIRST : last + 1], rising, column[::-1]) for column in means.T]
    return np.array([column.mean() for column in read])
