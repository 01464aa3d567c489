"""Log odds that a hypothesis is an object of its class, from the evidence of each sensor.

Independent evidence adds up in log odds, log p / (1 - p): to those of the prior, each observation adds the logarithm of
its likelihood ratio (Good, Probability and the weighing of evidence, 1950).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, U8, Bools
from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.detectors.log_odds import logit, sigmoid, softly_limited
from lidcam.pipeline.fusion.belief.visibility import Visibility

MAX_LOG_ODDS = 6.0
"""Maximum absolute log odds of an object, for probabilities between 0.0025 and 0.9975."""

MIN_FULL_VIEW_SHARE = 0.6
"""Minimum visible share of an object with the recall of one in full view."""

MAX_HIDDEN_VIEW_SHARE = 0.1
"""Maximum visible share of an object that no detector finds."""

MAX_RECALL = 0.98
"""Maximum recall of a detector, whatever is set or learned from few objects."""

CUT_RECALL = 0.4
"""Relative recall for objects truncated by the image border."""

PEOPLE_LOG_ODDS = -1.4
"""Log odds of people in full view of a camera, added to those of drawn worlds: real streets have more posts and other
things that deceive cloud and image alike. In 40 frames of KITTI, it leaves all people that were found, and a third
of the others."""

VEHICLE_SHARE = 0.5
"""Share of `Coefficients.in_view` that counts for vehicles: fewer things look like them to both sensors."""


class Coefficients(NamedTuple):
    """Coefficients of the logistic model; `benchmarks/measured/belief_fit.py` fits them."""

    lidar: float  # Log odds of a lidar box of score 0.5, of one point and of a class of frequency 1
    lidar_score: float  # Factor of the logit of its score
    lidar_frequency: float  # Factor of the logarithm of `frequency` of its class: fewer boxes of rare classes are right
    lidar_points: float  # Factor of the logarithm of the number of its points
    placed: float  # Log odds of an object placed by a camera alone, without its 2D box
    frustum: float  # Log odds of an object whose points were sought in the frustum of a 2D box, without that box
    match: float  # Log likelihood ratio of a match with a 2D box of score 0.5 and no overlap
    match_score: float  # Factor of the logit of the 2D score
    match_iou: float  # Factor of the overlap
    further: float  # Weight of each further camera that agrees with the first: cameras are not independent
    # Added to the log odds of a network's lidar box in view of a camera: false people in a cloud often look like people
    # in an image, too
    in_view: float


FITTED = Coefficients(
    lidar=0.39,
    lidar_score=1.87,
    lidar_frequency=1.14,
    lidar_points=0.32,
    placed=-6.8,
    frustum=-1.5,
    match=0.77,
    match_score=1.5,
    match_iou=6.0,
    further=0.8,
    in_view=-2.0,
)
"""Coefficients fitted by `benchmarks/measured/belief_fit.py`, which also says on what data and with what result."""


def probability(log_odds: F64) -> F64:
    """Probability of log odds, softly limited by `MAX_LOG_ODDS`."""
    return sigmoid(softly_limited(log_odds, MAX_LOG_ODDS))


def log_odds_before_cameras(
    scores: F64,
    frequencies: F64,
    point_counts: I32,
    sources: U8,
    is_lidar: Bools,
    by: Coefficients,
    *,
    in_view: F64 | None = None,
    are_upright: Bools | None = None,
) -> F64:
    """(N,) log odds of boxes by the lidars alone.

    Args:
        scores: (N,) of the boxes.
        frequencies: (N,) `frequency` of their classes.
        point_counts: (N,) number of lidar points.
        sources: (N,) `Source` of each box.
        is_lidar: (N,) whether the lidars found it; 2D boxes propose the others.
        by: Coefficients.
        in_view: (2, N) the best of the `view_shares` of each box of a network, if the lidars' scores are probabilities;
            None for geometric scores of clusters.
        are_upright: (N,) whether their classes are people, on foot or riding; with `in_view`. In view of a camera,
            they are at least as probable as what a 2D box proposes by itself, as scores say little of people, and
            `PEOPLE_LOG_ODDS` is added to all of them.
    """
    score, points = logit(scores), np.log(np.maximum(point_counts, 1))
    proposed = np.where(sources == Source.CAMERA.value, by.placed, by.frustum)
    if in_view is not None:
        upright = np.zeros(len(score), np.bool_) if are_upright is None else are_upright
        rated = score + by.in_view * np.where(upright, in_view[0], VEHICLE_SHARE * in_view[1])
        rated = np.where(upright & (in_view[0] > 0), np.maximum(rated, by.frustum), rated)
        return np.asarray(np.where(is_lidar, rated, proposed) + PEOPLE_LOG_ODDS * upright * in_view[0])
    found = by.lidar + by.lidar_score * score + by.lidar_points * points + by.lidar_frequency * np.log(frequencies)
    return np.where(is_lidar, found, proposed)


def match_radii_m(priors: Sequence[ClassPrior]) -> F64:
    """(K,) match radius per class: half its longest side."""
    return np.array([max(prior.size_m) / 2 for prior in priors])


def position_probability(covariances: F64, radii_m: F64) -> F64:
    """(N,) probability that an object is within `radii_m` (N,) of its box; 1 where unknown.

    Rayleigh distribution for the mean of the variances in x and y, by covariances (N, 3, 3) over x, y and yaw.
    """
    variance = np.maximum((covariances[:, 0, 0] + covariances[:, 1, 1]) / 2, 1e-12)
    return np.asarray(-np.expm1(-(radii_m**2) / (2 * variance)))


def camera_evidence(visibility: Visibility, plain_recall: F64, by: Coefficients) -> F64:
    """(C, N) log likelihood ratio of each box by each camera's match, or lack of one.

    Args:
        visibility: Visibility of N boxes for C cameras.
        plain_recall: (C, N) recall of the camera for objects of that size in plain view.
        by: Coefficients.
    """
    ratio = by.match + by.match_score * logit(visibility.scores) + by.match_iou * visibility.iou
    recall = plain_recall * _shown(visibility) * np.where(visibility.is_cut, CUT_RECALL, 1.0) * visibility.in_view
    missed = np.log1p(-np.minimum(recall, MAX_RECALL))
    # A box of another class counts no more against it than none.
    matched = np.maximum(ratio + visibility.agreement, np.minimum(ratio, missed))
    return np.asarray(np.where(visibility.is_matched, matched, missed))


def view_shares(visibility: Visibility, plain_recall: F64) -> F64:
    """(2, C, N) how well each camera sees each box, from 0 (not in view, or hidden) to 1 (in full view).

    The second row leaves out how much is hidden, as long as a part shows, and counts the recall: what is too small for
    a camera cannot look like an object to it, too.
    """
    shown, whole = _shown(visibility), np.where(visibility.is_cut, CUT_RECALL, 1.0)
    return np.stack([shown, (shown > 0) * plain_recall]) * visibility.in_view * whole


def _shown(visibility: Visibility) -> F64:
    """(C, N) share of a detector's recall that is left of objects that are hidden in part."""
    share = (visibility.visible - MAX_HIDDEN_VIEW_SHARE) / (MIN_FULL_VIEW_SHARE - MAX_HIDDEN_VIEW_SHARE)
    return np.asarray(share.clip(0, 1))


def joined(evidence: F64, by: Coefficients) -> F64:
    """(N,) combined evidence of C cameras (C, N): the strongest for and against in full, the others less."""
    if not len(evidence):
        return np.zeros(evidence.shape[1])
    strongest = np.maximum(evidence.max(0), 0) + np.minimum(evidence.min(0), 0)
    return np.asarray((1 - by.further) * strongest + by.further * evidence.sum(0))


def joined_without_each(evidence: F64, by: Coefficients) -> F64:
    """(C, N) `joined` without each of C cameras in turn."""
    if len(evidence) < 2:
        return np.zeros_like(evidence)
    rows = np.arange(len(evidence))[:, None]
    ranked = np.sort(evidence, axis=0)
    highest = np.where(rows == evidence.argmax(0), ranked[-2], ranked[-1])
    lowest = np.where(rows == evidence.argmin(0), ranked[1], ranked[0])
    strongest = np.maximum(highest, 0) + np.minimum(lowest, 0)
    return np.asarray((1 - by.further) * strongest + by.further * (evidence.sum(0) - evidence))
