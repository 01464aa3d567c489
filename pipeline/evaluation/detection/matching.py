"""Matching of detections with true objects."""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F32, I32, Bools, Indices
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.detection.criteria import Criteria, Criterion
from lidcam.pipeline.evaluation.detection.tables import FALSE, IGNORED
from lidcam.pipeline.evaluation.evaluation_frame import SourceBoxes, TruthBoxes3D
from lidcam.pipeline.evaluation.ignoring import is_evaluated, is_within
from lidcam.pipeline.evaluation.near_objects import Candidates, FoundObjects, TrueObjects, pairs_near
from lidcam.pipeline.evaluation.vans import as_found


def by_falling_score(scores: F32) -> Indices:
    """(N,) rows by falling score; of equal scores the later row comes first, as in nuScenes's devkit."""
    return np.argsort(scores, kind="stable")[::-1]


def ranks_by_score(scores: F32) -> Indices:
    """(N,) place of each row in the order `by_falling_score`."""
    return np.argsort(by_falling_score(scores))


def match_by_score(found: Indices, truth: Indices, ranks: Indices, truth_count: int) -> I32:
    """Each detection, by falling score, takes the best true object that is still free.

    The result is the one stable matching in which all objects prefer the highest score, so all detections are matched
    at once by proposals (Gale and Shapley, College admissions, 1962).

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
    rules: Criteria,
    found: Boxes3D,
    truth: TruthBoxes3D,
    is_evaluated: Bools,
    is_ignored: Bools,
) -> I32:
    """Matches of detections with true objects of their class, under each of several criteria.

    A van is of the class of the detection that it is matched with by `position`, under all criteria.
    A detection that shows no evaluated object, but, by the criterion or by `position`, one of any class that is not
    evaluated, is neither right nor wrong; several may show the same such object.

    Args:
        pairs: Pairs that may belong together.
        criteria: K of them.
        rules: What is a van, and by which position a detection may show an object that is not evaluated.
        found: N detections.
        truth: T true objects.
        is_evaluated: (T,) of the true objects.
        is_ignored: (N,) detections that are ignored unless they show an evaluated object.

    Returns:
        (N, K) int32, row of the true object, `FALSE` or `IGNORED`.
    """
    ranks, position, vans = ranks_by_score(found.scores), rules.position, rules.vans
    evaluated, found_ids = is_evaluated[pairs.truth], found.class_ids[pairs.found]
    is_van, class_ids = vans.among(truth.class_ids, truth.labels), truth.class_ids
    if is_van.any():
        fits = evaluated & vans.fit(class_ids[pairs.truth], is_van[pairs.truth], found_ids)
        near = pairs.select(fits & position.holds(pairs, found_ids))
        near = near.select(near.best_first(position.measure))
        class_ids = as_found(class_ids, match_by_score(near.found, near.truth, ranks, len(truth)), found.class_ids)
    kept, others = pairs.select(evaluated & (found_ids == class_ids[pairs.truth])), pairs.select(~evaluated)
    kept_ids, other_ids = found.class_ids[kept.found], truth.class_ids[others.truth]
    other_ids = np.where(other_ids < 0, found.class_ids[others.found], other_ids)
    at_position = position.holds(others, other_ids)
    orders = {measure: kept.best_first(measure) for measure in {criterion.measure for criterion in criteria}}
    matches = np.empty((len(found), len(criteria)), np.int32)
    for column, criterion in enumerate(criteria):
        rows = orders[criterion.measure]
        rows = rows[criterion.holds(kept, kept_ids)[rows]]
        matched = match_by_score(kept.found[rows], kept.truth[rows], ranks, len(truth))
        ignored = is_ignored.copy()
        ignored[others.found[at_position | criterion.holds(others, other_ids)]] = True
        matches[:, column] = np.where(ignored & (matched == FALSE), IGNORED, matched)
    return matches


def match_frame(
    source: SourceBoxes, truth: TruthBoxes3D, criteria: Criteria, config: EvaluateConfig
) -> tuple[Candidates, I32, Bools]:
    """Pairs of one frame that may be one object, matches (N,) by `Criteria.position`, and (T,) what is evaluated."""
    found, position, counted = source.boxes, criteria.position, is_evaluated(truth, config)
    objects = FoundObjects.of([source], 0)
    pairs = pairs_near(objects, TrueObjects.of([truth], 0), criteria.scales)
    is_ignored = objects.is_ignored | ~is_within(found.centers, config)
    matches = match_criteria(
        pairs, [position], rules=criteria, found=found, truth=truth, is_evaluated=counted, is_ignored=is_ignored
    )
    return pairs, matches[:, 0], counted


def match_other_classes(
    pairs: Candidates, position: Criterion, *, matches: I32, found: Boxes3D, truth: TruthBoxes3D, is_evaluated: Bools
) -> I32:
    """(N,) int32 rows of missed objects of another class that false detections show, or `FALSE`.

    Arguments as of `match_criteria`; `matches` (N,) are those by `position`, with the limit of the true object's class.
    """
    missed = is_evaluated.copy()
    missed[matches[matches >= 0]] = False
    left = pairs.select((matches[pairs.found] == FALSE) & missed[pairs.truth])
    left = left.select(position.holds(left, truth.class_ids[left.truth]))
    rows = left.best_first("distance")
    return match_by_score(left.found[rows], left.truth[rows], ranks_by_score(found.scores), len(truth))
