"""How the objects of one frame differ between two results."""

import numpy as np

from pipeline.core.arrays import F64, I64, Array, Bools
from pipeline.core.geometry.boxes import wrap_angle
from pipeline.core.settings.compare import CompareConfig
from pipeline.evaluation.comparison.matching import Matched, match_boxes, match_images
from pipeline.evaluation.comparison.objects import ImageObjects, SourceObjects
from pipeline.evaluation.comparison.records import Changes
from pipeline.evaluation.records import UNKNOWN

__all__ = ["Tracks", "image_changes", "source_changes"]

ROUNDING, ROUNDING_PX = 1e-6, 1e-3
"""Added to what counts as equal: scores and pixels are of single precision, where 0.2 - 0.1 is more than 0.1."""


class Tracks:
    """Which track of A is which of B: ids are names, and two results may name the same object differently."""

    def __init__(self) -> None:
        self._of_first: dict[int, int] = {}
        self._of_second: dict[int, int] = {}

    def are_broken(self, first: I64, second: I64) -> Bools:
        """(M,) whether an object of A and B goes on under an id that was another object's before; takes in the pairs.

        Args:
            first: (M,) ids in A of the objects that both have; `UNKNOWN` where it has none.
            second: (M,) their ids in B.
        """
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        broken = [
            UNKNOWN not in (a, b) and (self._of_first.get(a, b) != b or self._of_second.get(b, a) != a)
            for a, b in pairs
        ]
        for a, b in pairs:
            if UNKNOWN not in (a, b):
                self._of_first[a], self._of_second[b] = b, a
        return np.array(broken, np.bool_)


def source_changes(first: SourceObjects, second: SourceObjects, config: CompareConfig, tracks: Tracks) -> Changes:
    """How the objects of one source differ; `tracks` are those of the source, up to this frame."""
    rows = match_boxes(first, second, config.gate * np.maximum(first.lengths_m[:, None], second.lengths_m))
    i, j = rows
    a, b = first.found.boxes, second.found.boxes
    turn = wrap_angle(a.yaws[i] - b.yaws[j])
    measured = [
        (np.linalg.norm(a.centers[i] - b.centers[j], axis=1), config.position_m),
        (np.degrees(np.abs(turn)), config.yaw_deg),
        (_apart(a.sizes[i], b.sizes[j]).max(1, initial=0.0), config.size_m),
        (first.classes[i] != second.classes[j], 0.0),
        (_apart(a.scores[i], b.scores[j]), config.score),
        (tracks.are_broken(first.found.track_ids[i], second.found.track_ids[j]), 0.0),
    ]
    return _changes(rows, len(a), len(b), measured)


def image_changes(first: ImageObjects, second: ImageObjects, config: CompareConfig) -> Changes:
    """How the 2D boxes of one image differ; they have neither heading nor size of their own, nor tracks."""
    rows = match_images(first, second, config.min_iou)
    i, j = rows
    a, b = first.found, second.found
    nothing = np.zeros(len(i)), 0.0
    measured = [
        (_apart(a.xyxy[i], b.xyxy[j]).max(1, initial=0.0), config.pixels + ROUNDING_PX),
        nothing,
        nothing,
        (first.classes[i] != second.classes[j], 0.0),
        (_apart(a.scores[i], b.scores[j]), config.score),
        nothing,
    ]
    return _changes(rows, len(a), len(b), measured)


def _apart(first: Array, second: Array) -> F64:
    return np.abs(first.astype(np.float64) - second.astype(np.float64))


def _changes(rows: Matched, n: int, m: int, measured: list[tuple[Array, float]]) -> Changes:
    amounts = np.column_stack([amount for amount, _ in measured]).astype(np.float64)
    most = np.array([allowed for _, allowed in measured])
    return Changes(
        rows.first,
        rows.second,
        np.setdiff1d(np.arange(n), rows.first),
        np.setdiff1d(np.arange(m), rows.second),
        amounts,
        amounts > most + ROUNDING,
    )
