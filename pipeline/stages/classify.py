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
        seen = [(matches.pairs.T, boxes2d[name]) for name, matches in hypotheses.matches.items() if matches]
        if not seen:
            return hypotheses
        odds = class_log_odds(boxes.sizes, boxes.class_ids, self._priors)
        rows = np.concatenate([rows for (rows, _), _ in seen])
        named = np.concatenate([found.class_ids[rows2d] for (_, rows2d), found in seen])
        scores = np.concatenate([found.scores[rows2d] for (_, rows2d), found in seen]).astype(np.float64)
        np.add.at(odds, rows, vote_log_odds(named, scores, self._taken_for))
        is_matched = np.bincount(rows, minlength=len(boxes)) > 0
        class_ids = np.where(is_matched, odds.argmax(1), boxes.class_ids).astype(np.int32)
        return replace(hypotheses, boxes=replace(boxes, class_ids=class_ids))
