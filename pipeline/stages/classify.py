"""The class of each hypothesis, by its size and the votes of the lidars and the cameras.

The confusion of classes follows from their sizes: a van and a truck look alike, a car and a pedestrian do not. So there
is no table of names, and custom classes work like the default ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Indices
from lidcam.pipeline.core.association import class_distances
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.detectors.log_odds import logit

CONFUSION_SCALE = 0.45
"""Distance of classes, in logarithms of length, width, height, over which the share of votes falls to 1/e."""

DETECTOR_LOG_ODDS = 0.2
"""Log odds of the class by the detector, which knows the shape of the points beside the size of the box."""

MISSING_SIGMA = 0.2
"""Standard deviation of missing extent, as a share of the class extent."""

MAX_MISSING_SIGMAS = 3.0
"""Maximum missing extent, in standard deviations."""

MISSING_WEIGHTS = np.array([0.15, 0.15, 0.9])
"""Weights of missing length, width and height: sides are often hidden, tops seldom."""

COMPLETED_WEIGHTS = np.array([0.15, 0.15, 0.2])
"""The same weights for a completed extent, which may be larger."""

MAX_EXCESS_SIGMAS = 4.0
"""Maximum excess of a measured extent over the class, in standard deviations."""

COMPLETED_TOLERANCE = 1e-3
"""Maximum relative difference from the typical extent of the class for an extent that was completed, not measured."""


RIDER_AS_PERSON = 0.5
"""Share of riders whom a detector that knows no riders finds as a person alone."""

MAX_SCORE_LOG_ODDS = 3.0
"""Maximum log odds of the class by the lidars' score."""


class Classify:
    """Classes of the hypotheses of a frame."""

    def __init__(
        self,
        classes: Sequence[ClassPrior],
        riders: frozenset[tuple[int, int]] = frozenset(),
        *,
        score_groups: I64 | None = None,
    ) -> None:
        """Classify into these classes.

        Args:
            classes: All classes.
            riders: `Detect2D.riders`.
            score_groups: (K,) number of a group for each class: those that the lidars' scores do not tell apart share
                one. None: the scores are no probabilities.
        """
        self._priors, self._score_groups = tuple(classes), score_groups
        self._taken_for = confusion(classes)
        # A rider whose bicycle the detector overlooks is a person to it.
        self._ridden_for = self._taken_for.copy()
        for ridden, person in riders:
            share = 1.0 if score_groups is None else RIDER_AS_PERSON
            self._ridden_for[ridden, person] = share * self._taken_for[person, person]

    def __call__(self, hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D]) -> Hypotheses:
        """The same hypotheses, each of its most probable class; unmatched ones keep theirs.

        Where a detector that knows no riders sees a person and the lidars a bicycle, either may be right, and the
        lidars' score decides. Among equally probable classes the lowest id is taken.

        Args:
            hypotheses: N boxes, and their matches with `boxes2d`.
            boxes2d: By camera name; each vote counts with its score.
        """
        boxes = hypotheses.boxes
        seen = [(matches.pairs.T, boxes2d[name]) for name, matches in hypotheses.matches.items() if matches]
        if not seen:
            return hypotheses
        odds = class_log_odds(boxes.sizes, boxes.class_ids, self._priors)
        own = np.arange(hypotheses.lidar_count)
        if (groups := self._score_groups) is not None:
            by_score = logit(boxes.scores[own].astype(np.float64)).clip(0.0, MAX_SCORE_LOG_ODDS)
            odds[own] += by_score[:, None] * (groups == groups[boxes.class_ids[own], None])
        rows = np.concatenate([rows for (rows, _), _ in seen])
        named = np.concatenate([found.class_ids[rows2d] for (_, rows2d), found in seen])
        scores = np.concatenate([found.scores[rows2d] for (_, rows2d), found in seen])[:, None].astype(np.float64)
        by_lidar = (rows < hypotheses.lidar_count)[:, None]
        votes = [
            np.log(scores * taken_for[:, named].T + (1 - scores) / len(taken_for) + 1e-12)  # one of score 0 is none
            for taken_for in (self._ridden_for, self._taken_for)
        ]
        np.add.at(odds, rows, np.where(by_lidar, *votes))
        is_matched = np.bincount(rows, minlength=len(boxes)) > 0
        class_ids = np.where(is_matched, odds.argmax(1), boxes.class_ids).astype(np.int32)
        return replace(hypotheses, boxes=replace(boxes, class_ids=class_ids))


def confusion(priors: Sequence[ClassPrior]) -> F64:
    """(K, K) probability that an object of the class of the row is taken for that of the column.

    Between classes of similar size this falls faster than `class_confusion`, by which boxes are matched: another name
    should not prevent a match, but here it decides.
    """
    alike = np.exp(-np.sqrt(class_distances(priors)) / CONFUSION_SCALE)
    return np.asarray(alike / alike.sum(1, keepdims=True))


def class_log_odds(sizes: F64, own_ids: I32, priors: tuple[ClassPrior, ...]) -> F64:
    """(N, K) log likelihood of each class, given boxes (N, 3) and classes (N,) of a 3D detector.

    An extent equal to the typical one of its class was completed to it, so the visible part is shorter. Where length or
    width alone was completed, the other one may be either extent of an object of another class. The best fitting kind
    of a class counts.
    """
    typical, spread, starts = _kinds(priors)
    is_own = np.repeat(np.arange(len(priors)), np.diff(starts, append=len(typical))) == own_ids[:, None]
    is_typical = np.abs(sizes[:, None] - typical) <= COMPLETED_TOLERANCE * typical
    is_measured = ~(is_typical & is_own[..., None]).any(1)
    fits = _fits(sizes, is_measured, typical, spread)
    turned = _fits(sizes[:, [1, 0, 2]], is_measured[:, [1, 0, 2]], typical, spread)
    may_be_turned = ~is_own & (is_measured[:, 0] != is_measured[:, 1])[:, None]
    odds = np.maximum.reduceat(np.where(may_be_turned, np.maximum(fits, turned), fits), starts, axis=1)
    odds[np.arange(len(sizes)), own_ids] += DETECTOR_LOG_ODDS
    return np.asarray(odds)


def _fits(sizes: F64, is_measured: Bools, typical: F64, spread: F64) -> F64:
    """(N, M) log likelihood of the extents of boxes (N, 3), some of them measured, by those of M kinds (M, 3)."""
    long = (np.maximum(sizes[:, None] - typical, 0.0) / np.maximum(spread, 1e-9)).clip(max=MAX_EXCESS_SIGMAS)
    short = (np.maximum(typical - sizes[:, None], 0.0) / (MISSING_SIGMA * typical)).clip(max=MAX_MISSING_SIGMAS)
    weights = np.where(is_measured, MISSING_WEIGHTS, COMPLETED_WEIGHTS)
    return np.asarray(-(long**2 * is_measured[:, None] + weights[:, None] * short**2).sum(2) / 2)


@cache
def _kinds(priors: tuple[ClassPrior, ...]) -> tuple[F64, F64, Indices]:
    """(M, 3) typical sizes of the kinds of all classes, (M, 3) standard deviations above these, (K,) first of each."""
    kinds = [(prior.size_m, *prior.kinds_m) for prior in priors]
    typical = np.array([size for sizes_of_class in kinds for size in sizes_of_class])
    room = np.array([np.divide(prior.max_size_m, prior.size_m) for prior in priors])
    counts = [len(one) for one in kinds]
    spread = typical * (np.repeat(room, counts, axis=0) - 1) / 2
    return typical, spread, np.cumsum([0, *counts[:-1]])
