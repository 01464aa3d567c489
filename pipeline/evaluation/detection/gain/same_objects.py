"""How much nearer fusion places the objects that another source found, too.

The mean error of a source is that of what it found. A source that finds near objects alone looks better than one that
finds far ones as well, so means of different objects do not say who places better.
"""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.evaluation.detection.errors import bird_eye_m
from pipeline.evaluation.detection.gain.resampling import Resampling
from pipeline.evaluation.detection.source import Source
from pipeline.evaluation.records import Figures

__all__ = ["PERCENTILES", "gain_on_same_objects"]

PERCENTILES = (2.5, 97.5)


def gain_on_same_objects(
    fused: Source, single: Source, class_id: int | None, resampling: Resampling, *, has_interval: bool
) -> Figures:
    """By how many metres the fused position is better, mean of the objects of a class that both found.

    Args:
        fused: The fused objects.
        single: The other source.
        class_id: The class; None: all.
        resampling: Samples of the recording.
        has_interval: Whether there are enough blocks for an interval.
    """
    gains_m = _errors_m(single, class_id) - _errors_m(fused, class_id)
    rows = np.flatnonzero(np.isfinite(gains_m))
    found: dict[str, float | int | bool | None] = {"objects": len(rows)}
    if not len(rows):
        return found | dict.fromkeys(("value", "low", "high", "takes_away"))
    found["value"] = float(gains_m[rows].mean())
    if not has_interval:
        return found | dict.fromkeys(("low", "high", "takes_away"))
    frames = fused.site.truth.frames[rows]
    counts = resampling.sums(frames)
    means = resampling.sums(frames, gains_m[rows])[counts > 0] / counts[counts > 0]
    low, high = map(float, np.percentile(means, PERCENTILES))
    return found | {"low": low, "high": high, "takes_away": high < 0}


def _errors_m(source: Source, class_id: int | None) -> F64:
    """(T,) error of the position that a source gives to each true object; NaN where it did not find it."""
    detections = source.scored(class_id, source.site.criteria.position_row)
    right = detections.is_right
    errors_m = np.full(len(source.site.truth), np.nan)
    errors_m[detections.truth_rows[right]] = bird_eye_m(source.found.errors[0, detections.rows[right]])
    return errors_m
