"""Gain of fusion over the better single source."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.settings.config import ALL_CLASSES
from lidcam.pipeline.evaluation.detection.averages import overlap_name
from lidcam.pipeline.evaluation.detection.errors import bird_eye_m
from lidcam.pipeline.evaluation.detection.resampling import Resampling, sampled_ap
from lidcam.pipeline.evaluation.detection.source import Source
from lidcam.pipeline.evaluation.evaluation_frame import Figures, figure_at

_FUSED = "fused"
_IOU = 0.5
_MIN_BLOCKS = 5
"""Smallest number of blocks for an interval."""

_ROUNDING = 1e-9
"""Relative difference of equal figures: sums of the same errors in another order differ in the last digits."""

PERCENTILES = (2.5, 97.5)

_POSITION = "errors.position_bev_m.mean"

Gain = dict[str, float | int | str | bool | None]
Samples = dict[str, F64]


def fusion_gain(sources: Mapping[str, Source], figures: Mapping[str, Figures], resampling: Resampling) -> Figures:
    """Gain of `fused` over the better of the other sources, by class and figure, with an interval of 95 %.

    A gain is positive where fusion is better, also for the error of position, and exactly 0 where the figures differ by
    rounding alone. `same_objects` compares positions of the objects that both found. The better source is chosen on the
    whole recording. The interval is the percentile bootstrap (Efron and Tibshirani, An introduction to the bootstrap,
    1993, chapter 13), both sources on the same samples. Empty without fused objects or without another source.
    """
    singles = [name for name in sources if name != _FUSED]
    if _FUSED not in sources or not singles:
        return {}
    samples = {name: _samples_by_class(source, resampling) for name, source in sources.items()}
    has_interval = resampling.block_count >= _MIN_BLOCKS
    gains: dict[str, Figures] = {}
    for class_name, by_figure in samples[_FUSED].items():
        gain: dict[str, Any] = {"blocks": resampling.block_count}
        for name in by_figure:
            values = {source: figure_at(figures[source][class_name], name) for source in sources}
            drawn = {source: samples[source][class_name][name] for source in sources} if has_interval else {}
            gain[name] = _gain(values, drawn, singles, sign=-1 if name == _POSITION else 1)
        gain["errors"] = {"position_bev_m": {"mean": gain.pop(_POSITION)}}
        class_id = None if class_name == ALL_CLASSES else sources[_FUSED].site.class_names.index(class_name)
        gain["same_objects"] = {
            name: _gain_on_same_objects(sources[_FUSED], sources[name], class_id, resampling, has_interval=has_interval)
            for name in singles
        }
        gains[class_name] = gain
    return gains


def _gain(values: Mapping[str, float | None], drawn: Mapping[str, F64], singles: list[str], sign: int) -> Gain:
    fused = values[_FUSED]
    by_single = {name: value for name in singles if (value := values[name]) is not None}
    over = max(by_single, key=lambda name: sign * by_single[name], default=None)
    if over is None or fused is None:
        return {**dict.fromkeys(("value", "low", "high")), "fused": fused, "over": over, "takes_away": None}
    differences = sign * _difference(drawn[_FUSED], drawn[over]) if drawn else np.zeros(0)
    interval = _interval(differences[np.isfinite(differences)])
    value = sign * float(_difference(fused, by_single[over]))
    return {"value": value, "low": None, "high": None, "fused": fused, "over": over} | interval


def _interval(differences: F64) -> Gain:
    """The interval of 95 % of samples (S,); undefined without any."""
    if not len(differences):
        return dict.fromkeys(("low", "high", "takes_away"))
    low, high = map(float, np.percentile(differences, PERCENTILES))
    return {"low": low, "high": high, "takes_away": high < 0}


def _difference(first: npt.ArrayLike, second: npt.ArrayLike) -> F64:
    """`first` less `second`; 0 where they are equal but for rounding."""
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    is_equal = np.abs(first - second) <= _ROUNDING * np.maximum(np.abs(first), np.abs(second))
    return np.where(is_equal, 0.0, first - second) + 0.0


def _samples_by_class(source: Source, resampling: Resampling) -> dict[str, Samples]:
    """Figures of the samples, by class and name; NaN where one is not defined."""
    criteria, names = source.site.criteria, source.site.class_names
    iou = _IOU if _IOU in criteria.ious else criteria.ious[-1]
    overlaps = {
        f"ap_bev_r40_{overlap_name(iou)}": criteria.bev_column(iou),
        f"ap_3d_r40_{overlap_name(iou)}": criteria.volume_column(iou),
    }
    samples: dict[str, Samples] = {}
    for class_id, name in enumerate(names):
        of_class = {figure: _average_precision(source, resampling, class_id, one) for figure, one in overlaps.items()}
        samples[name] = of_class | _pooled(source, resampling, class_id)
    means = {figure: _mean([samples[name][figure] for name in names]) for figure in overlaps}
    return {**samples, ALL_CLASSES: means | _pooled(source, resampling, None)}


def _average_precision(source: Source, resampling: Resampling, class_id: int, criterion: int) -> F64:
    detections = source.scored(class_id, criterion)
    frames = source.found.frames[detections.rows]
    truth_frames = source.site.truth.frames[source.is_evaluated(class_id)]
    return sampled_ap(resampling, frames, detections.scores, detections.is_right, truth_frames)


def _pooled(source: Source, resampling: Resampling, class_id: int | None) -> Samples:
    detections = source.scored(class_id, source.site.criteria.position_column)
    frames, is_right = source.found.frames[detections.rows], detections.is_right
    errors_m = bird_eye_m(source.found.errors[detections.rows[is_right]])
    found, right = resampling.sums(frames), resampling.sums(frames[is_right])
    truth = resampling.sums(source.site.truth.frames[source.is_evaluated(class_id)])
    return {
        "precision": _ratio(right, found),
        "recall": _ratio(right, truth),
        "f1": _ratio(2 * right, np.where(truth > 0, truth + found, 0.0)),
        _POSITION: _ratio(resampling.sums(frames[is_right], errors_m), right),
    }


def _ratio(part: F64, whole: F64) -> F64:
    shares: F64 = np.divide(part, whole, out=np.full(len(part), np.nan), where=whole > 0)
    return shares


def _mean(values: list[F64]) -> F64:
    defined = np.isfinite(values)
    return _ratio(np.where(defined, values, 0.0).sum(0), defined.sum(0).astype(np.float64))


def _gain_on_same_objects(
    fused: Source, single: Source, class_id: int | None, resampling: Resampling, *, has_interval: bool
) -> Gain:
    """Mean improvement of the position, metres, over the objects of a class (None: of all) that both found.

    Mean errors of different objects do not compare: a source that finds near objects alone looks better.
    """
    gains_m = _errors_m(single, class_id) - _errors_m(fused, class_id)
    rows = np.flatnonzero(np.isfinite(gains_m))
    frames = fused.site.truth.frames[rows]
    counts = resampling.sums(frames)
    means = resampling.sums(frames, gains_m[rows])[counts > 0] / counts[counts > 0]
    value = float(gains_m[rows].mean()) if len(rows) else None
    return {"objects": len(rows), "value": value} | _interval(means if has_interval else np.zeros(0))


def _errors_m(source: Source, class_id: int | None) -> F64:
    """(T,) error of the position that a source gives to each true object; NaN where it did not find it."""
    detections = source.scored(class_id, source.site.criteria.position_column)
    right = detections.is_right
    errors_m = np.full(len(source.site.truth), np.nan)
    errors_m[detections.truth_rows[right]] = bird_eye_m(source.found.errors[detections.rows[right]])
    return errors_m
