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
from lidcam.pipeline.detectors.log_odds import logit, sigmoid
from lidcam.pipeline.fusion.belief.visibility import Visibility

MAX_LOG_ODDS = 7.0
"""No object is surer than 0.999, and none more impossible than 0.001."""

FULL_VIEW_SHARE = 0.6
HIDDEN_SHARE = 0.1
"""An object is expected to be found as in full view from the one visible share on, and not at all up to the other."""

MAX_RECALL = 0.98
"""No detector finds more than this, whatever is set or learned from few objects."""

CUT_RECALL = 0.7
"""Of objects that the border of the image cuts, a detector finds this share of what it would find of whole ones."""


class Coefficients(NamedTuple):
    """Coefficients of the logistic model; `benchmarks/measured/belief_fit.py` fits them.

    Attributes:
        lidar: Log odds of a lidar box of score 0.5, of one point and of a class of frequency 1.
        lidar_score: Factor of the logit of its score.
        lidar_frequency: Factor of the logarithm of `frequency` of its class: of what is rare, less is right.
        lidar_points: Factor of the logarithm of the number of its points.
        placed: Log odds of an object that a camera alone placed, without its 2D box.
        led: Log odds of an object whose points were sought in the frustum of a 2D box, without that box.
        led_score: Factor of the logit of the score of its points.
        match: Log likelihood ratio of a match with a 2D box of score 0.5 and no overlap.
        match_score: Factor of the logit of the 2D score.
        match_iou: Factor of the overlap.
        missed: Factor of the log likelihood of not being found by a camera that should have.
        further: Weight of each further camera that says the same as the first: cameras are not independent.
        looked_at: Added to the log odds of a probability by the lidars where a camera looks: what looks like a person
            in a cloud often looks like one in an image, too.
    """

    lidar: float
    lidar_score: float
    lidar_frequency: float
    lidar_points: float
    placed: float
    led: float
    led_score: float
    match: float
    match_score: float
    match_iou: float
    missed: float
    further: float
    looked_at: float


FITTED = Coefficients(
    lidar=0.39,
    lidar_score=1.87,
    lidar_frequency=1.14,
    lidar_points=0.32,
    placed=-6.8,
    led=-1.5,
    led_score=0.0,
    match=0.77,
    match_score=1.5,
    match_iou=6.0,
    missed=1.0,
    further=0.8,
    looked_at=-2.0,
)
"""Fitted to simulated recordings (6 s of `crossing` and `vehicle`, 10 s of `sandbox`; 2D boxes of the simulator) and to
five labelled frames of KITTI (2D boxes of YOLOX-nano), each of the four counting the same. With them, the expected
calibration error of a class is 0.00 to 0.02 (crossing), 0.02 to 0.09 (vehicle), 0.03 (sandbox), 0.00 to 0.18 (KITTI);
of 769, 851, 200 and 9 right hypotheses a threshold of 0.5 finds 750, 810, 200 and 9, with 2, 38, 0 and 0 false ones.
`missed`, `match_score`, `match_iou`, `led_score` and `further` are at the limits of the fit: one simulated detector
finds more, and is surer and more exact, than networks are.
`looked_at` is of 0, -1, -1.5 and -2 the best for 35 labelled frames of KITTI with YOLOX-nano and the network `traffic`;
for the simulated recordings -1 is, and -2 little worse. Of the false people of the real frames most are one post, seen
in five frames, and people in the distance whom nobody labelled.
"""


def probability(log_odds: F64) -> F64:
    """Probability of log odds, which are limited by `MAX_LOG_ODDS`."""
    return sigmoid(log_odds.clip(-MAX_LOG_ODDS, MAX_LOG_ODDS))


def log_odds_before_cameras(
    scores: F64,
    frequencies: F64,
    point_counts: I32,
    sources: U8,
    is_lidar: Bools,
    by: Coefficients,
    *,
    looked_at: Bools | None = None,
) -> F64:
    """(N,) log odds of boxes before a camera was asked.

    Args:
        scores: (N,) of the boxes.
        frequencies: (N,) `frequency` of their classes.
        point_counts: (N,) lidar points that they were found from.
        sources: (N,) `Source` of each box.
        is_lidar: (N,) whether the lidars found it; 2D boxes propose the others.
        by: The coefficients.
        looked_at: (N,) whether a camera looks at each box of a network, if the lidars' scores are probabilities; None:
            they are geometric scores of clusters.
    """
    score, points = logit(scores), np.log(np.maximum(point_counts, 1))
    if looked_at is not None:
        return np.where(is_lidar, score + by.looked_at * looked_at, _led(score, sources, by))
    found = by.lidar + by.lidar_score * score + by.lidar_points * points + by.lidar_frequency * np.log(frequencies)
    return np.where(is_lidar, found, _led(score, sources, by))


def _led(score: F64, sources: U8, by: Coefficients) -> F64:
    """(N,) log odds of what a camera led to, without its 2D box."""
    return np.where(sources == Source.CAMERA.value, by.placed, by.led + by.led_score * score)


def reach_of_classes(priors: Sequence[ClassPrior]) -> F64:
    """(K,) how far from its box an object of each class may be and still be what is meant: half of its largest side."""
    return np.array([max(prior.size_m) / 2 for prior in priors])


def at_its_place(covariances: F64, reach_m: F64) -> F64:
    """(N,) probability that an object is no farther than `reach_m` (N,) from where its box says; 1 where unknown.

    Rayleigh distribution for the mean of the variances in x and y.

    Args:
        covariances: (N, 3, 3) over x, y and yaw.
        reach_m: (N,) metres.
    """
    variance = np.maximum((covariances[:, 0, 0] + covariances[:, 1, 1]) / 2, 1e-12)
    return np.asarray(-np.expm1(-(reach_m**2) / (2 * variance)))


def camera_evidence(visibility: Visibility, plain_recall: F64, by: Coefficients) -> F64:
    """(C, N) log likelihood ratio of what each camera says, or does not say, about each box.

    Args:
        visibility: How C cameras see N boxes.
        plain_recall: (C, N) share of objects of that size in plain view that the camera finds.
        by: The coefficients.
    """
    ratio = by.match + by.match_score * logit(visibility.scores) + by.match_iou * visibility.iou
    shown = ((visibility.visible - HIDDEN_SHARE) / (FULL_VIEW_SHARE - HIDDEN_SHARE)).clip(0, 1)
    recall = plain_recall * shown * np.where(visibility.is_cut, CUT_RECALL, 1.0) * visibility.in_view
    missed = by.missed * np.log1p(-np.minimum(recall, MAX_RECALL))
    # A box of something else says no more against it than none.
    matched = np.maximum(ratio + visibility.agreement, np.minimum(ratio, missed))
    return np.asarray(np.where(visibility.is_matched, matched, missed))


def shown(visibility: Visibility) -> Bools:
    """(N,) whether a camera has each box in view, and sees some of it."""
    nobody = np.zeros((1, visibility.visible.shape[1]), np.bool_)
    return np.asarray(np.concatenate([nobody, visibility.in_view & (visibility.visible > HIDDEN_SHARE)]).any(0))


def joined(evidence: F64, by: Coefficients) -> F64:
    """(N,) evidence of C cameras (C, N) together: the strongest for and against count in full, the others less."""
    if not len(evidence):
        return np.zeros(evidence.shape[1])
    strongest = np.maximum(evidence.max(0), 0) + np.minimum(evidence.min(0), 0)
    return np.asarray((1 - by.further) * strongest + by.further * evidence.sum(0))


def joined_without_each(evidence: F64, by: Coefficients) -> F64:
    """(C, N) what `joined` gives without each of C cameras in turn."""
    if len(evidence) < 2:
        return np.zeros_like(evidence)
    rows = np.arange(len(evidence))[:, None]
    ranked = np.sort(evidence, axis=0)
    highest = np.where(rows == evidence.argmax(0), ranked[-2], ranked[-1])
    lowest = np.where(rows == evidence.argmin(0), ranked[1], ranked[0])
    strongest = np.maximum(highest, 0) + np.minimum(lowest, 0)
    return np.asarray((1 - by.further) * strongest + by.further * (evidence.sum(0) - evidence))
