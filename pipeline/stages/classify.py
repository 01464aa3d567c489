"""The class of each hypothesis, from its size and from what the lidars and the cameras take it for."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.core.detections import Boxes2D, Hypotheses
from pipeline.core.settings.config import Config
from pipeline.fusion.naming import class_log_odds, confusion, vote_log_odds

__all__ = ["Classify"]


class Classify:
    """Classes of the hypotheses of a frame."""

    def __init__(self, config: Config) -> None:
        self._priors = config.classes
        self._taken_for = confusion(config.classes)

    def __call__(self, hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D]) -> Hypotheses:
        """The same hypotheses, each of its most probable class; what no camera is matched with keeps its own.

        Of classes that are equally probable the lowest id is taken.

        Args:
            hypotheses: N boxes, and their matches with `boxes2d`.
            boxes2d: By camera name; each vote counts with its score.
        """
        boxes = hypotheses.boxes
        odds = class_log_odds(boxes.sizes, boxes.class_ids, self._priors)
        seen = [(matches.pairs, boxes2d[name]) for name, matches in hypotheses.matches.items() if name in boxes2d]
        rows = np.concatenate([np.zeros(0, np.int64), *(pairs[:, 0] for pairs, _ in seen)])
        named = np.concatenate([np.zeros(0, np.int32), *(found.class_ids[pairs[:, 1]] for pairs, found in seen)])
        scores = np.concatenate([np.zeros(0), *(found.scores[pairs[:, 1]] for pairs, found in seen)])
        np.add.at(odds, rows, vote_log_odds(named, scores, self._taken_for))
        is_matched = np.bincount(rows, minlength=len(boxes)) > 0
        class_ids = np.where(is_matched, odds.argmax(1), boxes.class_ids).astype(np.int32)
        return replace(hypotheses, boxes=replace(boxes, class_ids=class_ids))
