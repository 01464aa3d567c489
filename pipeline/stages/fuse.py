"""Fusion, the last step: the hypotheses that are probable enough become the objects of the frame."""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Fused, Hypotheses
from pipeline.core.settings.config import Config

__all__ = ["Fuse"]


class Fuse:
    """Choice of the objects of a frame."""

    def __init__(self, config: Config) -> None:
        self._min_score = config.fuse.min_score

    def __call__(self, hypotheses: Hypotheses, beliefs: F64) -> Fused:
        """The objects of a frame, in the order of the hypotheses; the score of each is its probability.

        Args:
            hypotheses: N boxes in the site frame, and their matches.
            beliefs: (N,) existence probability of each.
        """
        scores = beliefs.astype(np.float32)
        rows = np.flatnonzero(scores >= np.float32(self._min_score))
        objects = replace(hypotheses.boxes, scores=scores).select(rows)
        return Fused(objects, hypotheses.matched[rows], rows.astype(np.int64))
