"""The class of each hypothesis, from its size and from what the lidars and the cameras take it for."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import F64, I32
from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.settings.config import Config

__all__ = ["Classify"]


class Classify:
    """Classes of the hypotheses of a frame."""

    def __init__(self, config: Config) -> None:
        self._class_count = len(config.classes)

    def __call__(self, hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D]) -> Hypotheses:
        """The same hypotheses, each of the class that most speaks for.

        Each matched camera votes with its score; of classes with equal votes the 3D box's own wins, then the lowest
        class id.
        """
        boxes = hypotheses.boxes
        votes = np.zeros((len(boxes), self._class_count))
        for name, found in boxes2d.items():
            rows, rows2d = hypotheses.matches[name].pairs.T  # each row at most once, so indexed += adds correctly
            votes[rows, found.class_ids[rows2d]] += found.scores[rows2d]
        return replace(hypotheses, boxes=replace(boxes, class_ids=_winners(votes, boxes.class_ids)))


def _winners(votes: F64, own_ids: I32) -> I32:
    """(N,) class id with the most votes (N, C); the box's own unless another has more."""
    best = votes.argmax(1)
    rows = np.arange(len(votes))
    return np.where(votes[rows, own_ids] >= votes[rows, best], own_ids, best).astype(np.int32)
