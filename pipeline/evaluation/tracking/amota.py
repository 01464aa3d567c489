"""Averages of CLEAR MOT over recall, as in the tracking task of nuScenes.

Weng et al., "3D multi-object tracking: a baseline and new evaluation metrics", IROS 2020.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.evaluation.tracking.clear import match_clear
from lidcam.pipeline.evaluation.tracking.table import TrackTable

MIN_RECALL, RECALLS = 0.1, 40


def amota_figures(table: TrackTable) -> dict[str, float | None]:
    """AMOTA and AMOTP of one class; None without truth.

    A track has the mean score of its boxes. For each of 40 recalls from 0.1 to 1, only tracks from a score on take
    part: the one with which as many objects are matched, if all tracks take part. Of each set the MOTA is taken
    relative to what it recalls, MOTAR = 1 - false positives / matches without a switch, and the mean distance of the
    matches. A recall that is not reached counts with 0, and with the largest distance of a match.
    """
    if not len(table.truth):
        return {"amota": None, "amotp_m": None}
    lengths = np.maximum(1, np.bincount(table.found.tracks))
    scores = (np.bincount(table.found.tracks, table.found.scores) / lengths)[table.found.tracks]
    values: dict[int, tuple[float, float]] = {}
    rates = []
    for threshold in _score_thresholds(table, scores):
        kept = scores >= threshold
        count = int(kept.sum())
        if count not in values:
            values[count] = _motar_motp(table, kept)
        rates.append(values[count])
    missing = [(0.0, table.max_distance_m)] * (RECALLS - len(rates))
    motar, motp_m = np.mean([*rates, *missing], 0)
    return {"amota": float(motar), "amotp_m": float(motp_m)}


def _score_thresholds(table: TrackTable, scores: F64) -> F64:
    """The smallest scores of tracks for the recalls that are reached, interpolated between scores of matches."""
    matches = match_clear(table, np.ones(len(scores), np.bool_))
    matched = np.sort(scores[table.pairs.found[matches.pairs[~matches.is_switch]]])[::-1]
    if not len(matched):
        return np.zeros(0)
    recalls = np.linspace(MIN_RECALL, 1, RECALLS).round(12)
    reached = np.arange(1, len(matched) + 1) / len(table.truth)
    return np.asarray(np.interp(recalls[recalls <= reached[-1]], reached, matched))


def _motar_motp(table: TrackTable, kept: Bools) -> tuple[float, float]:
    matches = match_clear(table, kept)
    steady = int((~matches.is_switch).sum())
    motar = max(0.0, 1 - (int(kept.sum()) - len(matches.pairs)) / steady) if steady else 0.0
    motp_m = float(table.pairs.distances_m[matches.pairs].mean()) if len(matches.pairs) else table.max_distance_m
    return motar, motp_m
