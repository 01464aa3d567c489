"""Which detection shows which true object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I32, Bools, Indices, Rows, select_rows
from pipeline.evaluation.detection.criteria import Criterion, Measure
from pipeline.evaluation.detection.tables import FALSE, IGNORED

__all__ = [
    "Candidates",
    "by_falling_score",
    "match_by_score",
    "match_criteria",
    "match_other_classes",
    "ranks_by_score",
]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairs of a detection and a true object of the same frame that may belong together.

    Attributes:
        found: (P,) rows of the detections.
        truth: (P,) rows of the true objects.
        bev: (P,) float64, IoU seen from above.
        volume: (P,) float64, IoU in 3D.
        distance: (P,) float64, of the centres seen from above, metres.
    """

    found: Indices
    truth: Indices
    bev: F64
    volume: F64
    distance: F64

    def fulfil(self, criterion: Criterion, class_ids: I32) -> Bools:
        """(P,) where the criterion holds, with the limits of the given classes (P,)."""
        if criterion.measure == "distance":
            return self.distance < criterion.limits[class_ids]
        values = self.bev if criterion.measure == "bev" else self.volume
        return values >= criterion.limits[class_ids]

    def order(self, measure: Measure) -> Indices:
        """The pairs detection by detection, the best true object first, the earlier one of two equally good ones."""
        values = {"distance": self.distance, "bev": -self.bev, "volume": -self.volume}[measure]
        return np.lexsort((self.truth, values, self.found))

    def select(self, rows: Rows) -> "Candidates":
        """The given pairs (mask or indices), in that order."""
        return select_rows(self, rows)


def by_falling_score(scores: F32) -> Indices:
    """(N,) rows by falling score; of equal scores the later row comes first, as in nuScenes's devkit."""
    return np.argsort(scores, kind="stable")[::-1]


def ranks_by_score(scores: F32) -> Indices:
    """(N,) place of each row in the order `by_falling_score`."""
    ranks = np.empty(len(scores), np.intp)
    ranks[by_falling_score(scores)] = np.arange(len(scores))
    return ranks


def match_by_score(found: Indices, truth: Indices, ranks: Indices, truth_count: int) -> I32:
    """By falling score, each detection takes the best true object that is still free.

    That is the one stable matching between detections that prefer their best objects and objects that all prefer the
    highest score, so it is found for all detections at once: each asks for its best object, the object keeps the
    highest score and the others ask for their next best (Gale and Shapley, College admissions, 1962).

    Args:
        found: (P,) row of the detection of each possible pair, ascending.
        truth: (P,) row of its true object; the pairs of one detection stand in the order of its preference.
        ranks: (N,) places of all detections by falling score, each one once.
        truth_count: Number of true objects.

    Returns:
        (N,) int32, row of each detection's true object, or `FALSE`.
    """
    matches = np.full(len(ranks), FALSE, np.int32)
    asked = np.searchsorted(found, np.arange(len(ranks)), side="left")
    end = np.searchsorted(found, np.arange(len(ranks)), side="right")
    asking = np.flatnonzero(asked < end)
    best = np.full(truth_count, len(ranks), np.intp)
    while True:
        wanted = truth[asked[asking]]
        np.minimum.at(best, wanted, ranks[asking])
        lost = best[wanted] != ranks[asking]
        if not lost.any():
            matches[asking] = wanted
            return matches
        asked[asking[lost]] += 1
        asking = asking[asked[asking] < end[asking]]


def match_criteria(
    pairs: Candidates,
    criteria: Sequence[Criterion],
    *,
    position: Criterion,
    found_ids: I32,
    truth_ids: I32,
    scores: F32,
    is_evaluated: Bools,
    is_ignored: Bools,
) -> I32:
    """Matches of detections with true objects of their class, under each of several criteria.

    A detection that shows no evaluated object, but one of any class that is not evaluated, is neither right nor wrong.
    Whether it shows such an object is decided by the criterion or by `position`: nobody asks how well something is
    placed on an object that does not count. It may be one of several that do.

    Args:
        pairs: What may belong together.
        criteria: K of them.
        position: By which a detection may show an object that is not evaluated.
        found_ids: (N,) classes of the detections.
        truth_ids: (T,) classes of the true objects, or `UNKNOWN`.
        scores: (N,) of the detections.
        is_evaluated: (T,) of the true objects.
        is_ignored: (N,) detections that are ignored unless they show an evaluated object.

    Returns:
        (K, N) int32, row of the true object, `FALSE` or `IGNORED`.
    """
    ranks = ranks_by_score(scores)
    evaluated = is_evaluated[pairs.truth]
    same = evaluated & (found_ids[pairs.found] == truth_ids[pairs.truth])
    kept, others = pairs.select(np.flatnonzero(same)), pairs.select(np.flatnonzero(~evaluated))
    kept_ids = found_ids[kept.found]
    other_ids = np.where(truth_ids[others.truth] < 0, found_ids[others.found], truth_ids[others.truth])
    at_position = others.fulfil(position, other_ids)
    orders = {measure: kept.order(measure) for measure in {criterion.measure for criterion in criteria}}
    matches = np.empty((len(criteria), len(scores)), np.int32)
    for row, criterion in enumerate(criteria):
        rows = orders[criterion.measure]
        rows = rows[kept.fulfil(criterion, kept_ids)[rows]]
        matched = match_by_score(kept.found[rows], kept.truth[rows], ranks, len(truth_ids))
        ignored = is_ignored.copy()
        ignored[others.found[at_position | others.fulfil(criterion, other_ids)]] = True
        matches[row] = np.where(ignored & (matched == FALSE), IGNORED, matched)
    return matches


def match_other_classes(
    pairs: Candidates, position: Criterion, *, matches: I32, truth_ids: I32, scores: F32, is_evaluated: Bools
) -> I32:
    """Matches of false detections with missed objects: the place is right and the class is not.

    Args:
        pairs: What may belong together.
        position: Up to which distance, by the class of the true object.
        matches: (N,) by `position`.
        truth_ids: (T,) classes of the true objects.
        scores: (N,) of the detections.
        is_evaluated: (T,) of the true objects.

    Returns:
        (N,) int32, row of the true object, or `FALSE`.
    """
    missed = is_evaluated.copy()
    missed[matches[matches >= 0]] = False
    left = pairs.select(np.flatnonzero((matches[pairs.found] == FALSE) & missed[pairs.truth]))
    left = left.select(np.flatnonzero(left.fulfil(position, truth_ids[left.truth])))
    rows = left.order("distance")
    return match_by_score(left.found[rows], left.truth[rows], ranks_by_score(scores), len(truth_ids))
