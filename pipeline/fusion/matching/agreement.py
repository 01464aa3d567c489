"""What the other cameras say of an object, for each camera that sees it.

With the pairs of all cameras at hand, the place and the class of each 3D box are known better: for each camera they are
computed from the box and the 2D boxes of all *other* cameras, so that no pair speaks for itself. A 2D box that
contradicts the others then fits worse than before. The place is a weighted least-squares step in x, y and yaw; pairs
that fit badly weigh little (the weights of the t distribution).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64
from pipeline.core.association import FREEDOM
from pipeline.core.detections import Boxes3D
from pipeline.fusion.matching.agreement_kernels import sums_of_others
from pipeline.fusion.small_matrices import inverse

__all__ = [
    "BoxBelief",
    "MatchedPairs",
    "Others",
    "feature_jacobian",
    "prior_covariances",
    "spread",
    "what_box_says",
    "what_others_say",
]

UNKNOWN_SHARE, UNKNOWN_YAW = 0.1, 0.2
"""Standard deviations where a box has no covariance: of its place, as a share of length and width; of its yaw."""

LEAST_M, LEAST_RAD = 1e-3, 1e-2
"""Smallest standard deviations: a box is not known better."""

_LEAST = np.diag([LEAST_M, LEAST_M, LEAST_RAD]) ** 2


@dataclass(frozen=True, eq=False)
class BoxBelief:
    """What is known of N boxes before the cameras are asked.

    Attributes:
        covariances: (N, 3, 3) float64 of x, y, yaw, regular.
        log_classes: (N, K) float64, logarithm of the probability of each class, up to a constant.
        confusion: (K, K) float64 of `class_confusion`.
    """

    covariances: F64
    log_classes: F64
    confusion: F64

    @cached_property
    def information(self) -> F64:
        """(N, 3, 3) inverse covariances."""
        return inverse(self.covariances)

    @cached_property
    def log_confusion(self) -> F64:
        """(K, K) logarithm of `confusion`."""
        return np.log(self.confusion)


class MatchedPairs(NamedTuple):
    """T matched pairs of a box in an image and a 2D box.

    Attributes:
        seen: (T,) int64 row of the projected rectangles, each at most once.
        class_ids: (T,) int32 class of the 2D box.
        differences: (T, 4) float64, features of the 2D box less those of the projected rectangle.
        noise: (T, 4) float64, variances of these differences as far as they do not come from the place of the 3D box.
        squared: (T,) float64, how far the 2D box lies off, in standard deviations, squared.
        jacobians: (T, 4, 3) float64, derivatives of the features by x, y, yaw.
    """

    seen: I64
    class_ids: I32
    differences: F64
    noise: F64
    squared: F64
    jacobians: F64


class Others(NamedTuple):
    """For each of P boxes in an image, what the box and the other cameras say of it.

    Attributes:
        shifts: (P, 3) float64, to be added to x, y (metres) and yaw (radians) of the box.
        covariances: (P, 3, 3) float64 of x, y, yaw.
        log_classes: (P, K) float64, logarithm of the probability that a 2D detector gives each class.
    """

    shifts: F64
    covariances: F64
    log_classes: F64


def feature_jacobian(xyxy: F32, jacobian: F64) -> F64:
    """(P, 4, 3) derivatives of `rectangle_features` from those of the edges (P, 4, 3) of rectangles (P, 4)."""
    edges = xyxy.astype(np.float64)
    extent = np.maximum(edges[:, 2:] - edges[:, :2], 1.0)[..., None]
    low, high = jacobian[:, :2], jacobian[:, 2:]
    return np.concatenate([(low + high) / 2, (high - low) / extent], 1)


def prior_covariances(boxes: Boxes3D) -> F64:
    """(N, 3, 3) covariances of the boxes, with a guess by their size where they are unknown."""
    known = boxes.covariances
    unknown = (known == 0).all((1, 2))
    if unknown.any():
        guess = np.zeros((len(boxes), 3, 3))
        guess[:, 0, 0] = guess[:, 1, 1] = (UNKNOWN_SHARE * boxes.sizes[:, :2].mean(1)) ** 2
        guess[:, 2, 2] = UNKNOWN_YAW**2
        known = np.where(unknown[:, None, None], guess, known)
    return np.asarray(known + _LEAST)


def spread(covariances: F64, jacobians: F64) -> F64:
    """(P, 4) variances of features that covariances (P, 3, 3) of x, y, yaw make, by derivatives (P, 4, 3)."""
    return np.asarray((np.einsum("pfa,pab->pfb", jacobians, covariances) * jacobians).sum(2))


def what_box_says(boxes: BoxBelief, seen_rows: I64) -> Others:
    """As `what_others_say`, before anything is matched."""
    log_classes = _log_given(boxes.log_classes, boxes.confusion)
    return Others(np.zeros((len(seen_rows), 3)), boxes.covariances[seen_rows], log_classes[seen_rows])


def what_others_say(boxes: BoxBelief, seen_rows: I64, pairs: MatchedPairs) -> Others:
    """For each box in an image, its place and class by itself and by the pairs of the other cameras.

    Args:
        boxes: N boxes.
        seen_rows: (P,) the box of each projected rectangle.
        pairs: The matched ones of these rectangles.
    """
    normal, pull, log_classes = sums_of_others(
        seen_rows,
        boxes.information,
        boxes.log_classes,
        boxes.log_confusion,
        pairs.seen,
        pairs.class_ids,
        pairs.differences,
        pairs.noise,
        pairs.squared,
        pairs.jacobians,
        FREEDOM,
    )
    covariances = inverse(normal)
    return Others(np.einsum("pab,pb->pa", covariances, pull), covariances, _log_given(log_classes, boxes.confusion))


def _log_given(log_classes: F64, confusion: F64) -> F64:
    """(P, K) logarithm of the probability that a 2D detector gives each class, from that of each true class."""
    belief = np.exp(log_classes - log_classes.max(1, keepdims=True))
    belief /= belief.sum(1, keepdims=True)
    return np.asarray(np.log(np.einsum("pk,kc->pc", belief, confusion)))
