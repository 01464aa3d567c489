"""Fusion, the last step: the hypotheses that are probable enough become the objects of the frame."""

from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, Bools, Indices
from lidcam.pipeline.core.detections import Fused, Hypotheses
from lidcam.pipeline.core.geometry.overlaps import OVERLAP_SHARE, overlap_shares, without_overlaps
from lidcam.pipeline.core.settings.fuse import FuseConfig

HALF_SCORE_POINTS = 10.0
"""Number of points of an unknown object with a score of 0.5; three times as many score 0.75."""


class Fuse:
    """Choice of the objects of a frame."""

    def __init__(self, config: FuseConfig, *, class_count: int) -> None:
        self._min_score = np.float32(config.min_score)
        self._unknown_id = class_count if config.unknown else None

    def __call__(self, hypotheses: Hypotheses, beliefs: F64) -> Fused:
        """The objects of a frame, in the order of the hypotheses; the score of each is its probability.

        With `fuse.unknown`, improbable boxes of the lidars that stand apart from all objects follow, without a class;
        their score grows with their points.

        Args:
            hypotheses: N boxes in the site frame, and their matches.
            beliefs: (N,) existence probability of each.
        """
        boxes, scores, class_ids = hypotheses.boxes, beliefs.astype(np.float32), hypotheses.boxes.class_ids
        is_chosen = scores >= self._min_score
        if self._unknown_id is not None:
            unknown_scores = (boxes.point_counts / (boxes.point_counts + HALF_SCORE_POINTS)).astype(np.float32)
            rows = self._unknown_rows(hypotheses, is_chosen, unknown_scores)
            scores[rows], is_chosen[rows] = unknown_scores[rows], True
            class_ids = class_ids.copy()
            class_ids[rows] = self._unknown_id
        rows = np.flatnonzero(is_chosen)
        objects = replace(boxes, scores=scores, class_ids=class_ids).select(rows)
        return Fused(objects, hypotheses.matched[rows], rows.astype(np.int64))

    def _unknown_rows(self, hypotheses: Hypotheses, is_chosen: Bools, scores: F32) -> Indices:
        boxes = hypotheses.boxes
        is_lidar = np.arange(len(boxes)) < hypotheses.lidar_count
        rows = np.flatnonzero(is_lidar & ~is_chosen & (scores >= self._min_score) & (boxes.point_counts > 0))
        rows = rows[np.lexsort((rows, -boxes.point_counts[rows]))]
        rows = rows[(overlap_shares(boxes.select(rows), boxes.select(is_chosen)) <= OVERLAP_SHARE).all(1)]
        return rows[without_overlaps(boxes.select(rows))]
