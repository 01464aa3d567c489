"""The class of a hypothesis: how well its size fits each class, and what the lidars and the cameras take it for.

Which classes are confused follows from their sizes: a van and a truck look alike, a car and a pedestrian do not. So
there is no table of names, and classes of one's own work like the given ones.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from pipeline.core.arrays import F64, I32, I64
from pipeline.core.association import class_distances
from pipeline.core.settings.classes import ClassPrior
from pipeline.fusion.naming_kernels import size_log_odds

__all__ = ["class_log_odds", "confusion", "vote_log_odds"]


ALIKE = 0.45
"""The share of votes for another class falls to 1/e with each such step of the logarithms of length, width, height."""

OWN_LOG_ODDS = 0.2
"""What the detector's own choice counts for beyond the size of its box: the shape of the points."""

SHORT_SHARE = 0.2
SHORT_LIMIT = 3.0
"""A box shorter than its class errs by this share of it; missing extent counts at most so many standard deviations."""

SHORT_WEIGHTS = np.array([0.15, 0.15, 0.9])
COMPLETED_WEIGHTS = np.array([0.15, 0.15, 0.2])
"""Weight of missing length, width and height: sides are often hidden, tops seldom. What was completed may be larger."""

LONG_LIMIT = 4.0
"""A measured extent that no object of the class has counts at most so many standard deviations."""

MEASURED_SHARE = 1e-3
"""An extent that differs from the typical one of the class by less than this share was completed, not measured."""

_WEIGHTS = np.array([COMPLETED_WEIGHTS, SHORT_WEIGHTS])
_LIMITS = np.array([LONG_LIMIT, SHORT_SHARE, SHORT_LIMIT, MEASURED_SHARE, OWN_LOG_ODDS])
"""As `size_log_odds` takes them."""


def confusion(priors: Sequence[ClassPrior]) -> F64:
    """(K, K) probability that an object of the class of the row is taken for that of the column.

    Between classes of similar size this falls faster than `class_confusion`, by which boxes are matched: there, another
    name should not keep a pair apart; here, names are what is asked for.
    """
    alike = np.exp(-np.sqrt(class_distances(priors)) / ALIKE)
    return np.asarray(alike / alike.sum(1, keepdims=True))


def vote_log_odds(class_ids: I32, scores: F64, taken_for: F64) -> F64:
    """(M, K) log likelihood of each class, given that a detector names a class with a score.

    Args:
        class_ids: (M,) named classes.
        scores: (M,) in [0, 1]; a name of score 0 says nothing.
        taken_for: (K, K) of `confusion`.
    """
    said = taken_for[:, class_ids].T
    return np.asarray(np.log(scores[:, None] * said + (1 - scores[:, None]) / len(taken_for) + 1e-12))


def class_log_odds(sizes: F64, own_ids: I32, priors: Sequence[ClassPrior]) -> F64:
    """(N, K) log likelihood of each class, given box and class of a 3D detector.

    An extent that equals the typical one of its own class was completed to it: what was seen is shorter. Of several
    kinds of a class, that counts which fits best.

    Args:
        sizes: (N, 3) length, width, height, metres.
        own_ids: (N,) class that the detector gives.
        priors: The classes.
    """
    return size_log_odds(sizes, own_ids, *_kinds(tuple(priors)), _WEIGHTS, _LIMITS, len(priors))


@cache
def _kinds(priors: tuple[ClassPrior, ...]) -> tuple[F64, F64, I64]:
    """(M, 3) typical sizes of the kinds of all classes, (M, 3) standard deviations above these, (M,) their class."""
    kinds = [(prior.size_m, *prior.kinds_m) for prior in priors]
    typical = np.array([size for sizes_of_class in kinds for size in sizes_of_class])
    room = np.array([np.divide(prior.max_size_m, prior.size_m) for prior in priors])
    of_class = np.repeat(np.arange(len(priors)), [len(one) for one in kinds])
    return typical, typical * (room[of_class] - 1) / 2, of_class
