"""Evidence of the other pairs about an object and about a camera, for each camera that sees the object.

The pairs of all cameras improve the position and the class of each 3D box: for each camera both are computed from the
box and the 2D boxes of all *other* cameras, so that no pair supports itself. A 2D box that contradicts the others then
fits worse than before. The position is a weighted least-squares step in x, y and yaw; pairs with large residuals weigh
less (the weights of the t distribution). Likewise, the other pairs of a camera predict a common shift of its 2D boxes,
from a wrong calibration or a late image.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64
from lidcam.pipeline.core.association import FREEDOM
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.detectors.log_odds import softmax

UNKNOWN_SIGMA = 0.1
"""Standard deviation of the position of a box without covariance, as a share of the mean of length and width."""

UNKNOWN_YAW_SIGMA_RAD = 0.2
"""Standard deviation of the yaw of a box without covariance, radians."""

MIN_SIGMAS = np.array([1e-3, 1e-3, 1e-2])
"""Standard deviations added to x, y (metres) and yaw (radians) of every box."""


@dataclass(frozen=True, eq=False)
class BoxBelief:
    """Position and class of N boxes without cameras."""

    covariances: F64  # (N, 3, 3) float64 of x, y, yaw, regular
    log_classes: F64  # (N, K) float64, logarithm of the probability of each class, up to a constant
    confusion: F64  # (K, K) float64 from `class_confusion`

    @cached_property
    def information(self) -> F64:
        """(N, 3, 3) inverse covariances."""
        return np.asarray(np.linalg.inv(self.covariances), np.float64)

    @cached_property
    def log_confusion(self) -> F64:
        """(K, K) logarithm of `confusion`."""
        return np.log(self.confusion)


class MatchedPairs(NamedTuple):
    """T matched pairs of a box in an image and a 2D box."""

    seen: I64  # (T,) int64 row of the projected rectangles, each at most once
    class_ids: I32  # (T,) int32 class of the 2D box
    differences: F64  # (T, 4) float64, features of the 2D box less those of the projected rectangle
    noise: F64  # (T, 4) float64, variances of these differences, without those from the position of the 3D box
    squared: F64  # (T,) float64 squared distance of the 2D box, in standard deviations
    jacobians: F64  # (T, 4, 3) float64, derivatives of the features by x, y, yaw


class Others(NamedTuple):
    """Position and class of each of P boxes in an image, by the box itself and the other cameras."""

    shifts: F64  # (P, 3) float64 corrections of x, y (metres) and yaw (radians) of the box
    covariances: F64  # (P, 3, 3) float64 of x, y, yaw
    log_classes: F64  # (P, K) float64, logarithm of the probability that a 2D detector gives each class


def feature_jacobian(xyxy: F32, jacobian: F64) -> F64:
    """(P, 4, 3) derivatives of `rectangle_features` from those of the edges (P, 4, 3) of rectangles (P, 4)."""
    edges = xyxy.astype(np.float64)
    extent = np.maximum(edges[:, 2:] - edges[:, :2], 1.0)[..., None]
    low, high = jacobian[:, :2], jacobian[:, 2:]
    return np.concatenate([(low + high) / 2, (high - low) / extent], 1)


def prior_covariances(boxes: Boxes3D) -> F64:
    """(N, 3, 3) covariances of the boxes, guessed by their size where unknown."""
    guess = np.zeros((len(boxes), 3, 3))
    guess[:, 0, 0] = guess[:, 1, 1] = (UNKNOWN_SIGMA * boxes.sizes[:, :2].mean(1)) ** 2
    guess[:, 2, 2] = UNKNOWN_YAW_SIGMA_RAD**2
    is_known = (boxes.covariances != 0).any((1, 2), keepdims=True)
    return np.asarray(np.where(is_known, boxes.covariances, guess) + np.diag(MIN_SIGMAS) ** 2)


def spread(covariances: F64, jacobians: F64) -> F64:
    """(P, 4) variances of features from covariances (P, 3, 3) of x, y, yaw, by derivatives (P, 4, 3)."""
    return np.asarray((jacobians @ covariances * jacobians).sum(2))


def limited_slopes(jacobians: F64, covariances: F64, widest: F64) -> F64:
    """(P, 4, 3) derivatives by which features spread no further than `widest` (P, 4), their variances.

    Those of a box that reaches beside the camera say far more, up to infinity: its projection is no linear function.
    """
    variances = np.maximum(spread(covariances, jacobians), 1e-30)
    return np.asarray(jacobians * np.sqrt(np.minimum(widest / variances, 1.0))[..., None])


def before_matching(boxes: BoxBelief, seen_rows: I64) -> Others:
    """The result of `agreed_with_others` without any match."""
    log_classes = _log_given(boxes.log_classes, boxes.confusion)
    return Others(np.zeros((len(seen_rows), 3)), boxes.covariances[seen_rows], log_classes[seen_rows])


def agreed_with_others(boxes: BoxBelief, seen_rows: I64, pairs: MatchedPairs) -> Others:
    """Position and class of each box in an image by itself and by the pairs of the other cameras.

    Args:
        boxes: N boxes.
        seen_rows: (P,) box of each projected rectangle.
        pairs: Matched rectangles among these.
    """
    weights, slopes = _weights(pairs.squared, pairs.noise)[..., None], pairs.jacobians
    own_normal = (slopes * weights).swapaxes(1, 2) @ slopes
    own_pull = (slopes * weights * pairs.differences[..., None]).sum(1)
    normal, pull, log_classes = (
        _sums_of_others(values, pairs.seen, seen_rows)
        for values in (own_normal, own_pull, boxes.log_confusion.T[pairs.class_ids])
    )
    covariances = np.asarray(np.linalg.inv(boxes.information[seen_rows] + normal), np.float64)
    shifts = (covariances * pull[:, None]).sum(2)
    return Others(shifts, covariances, _log_given(boxes.log_classes[seen_rows] + log_classes, boxes.confusion))


def common_shifts(
    seen_cameras: I64, prior: F64, matched: I64, offsets_px: F64, variances: F64, squared: F64
) -> tuple[F64, F64]:
    """The shift that the other pairs of its camera predict for each pair.

    A mean with the weights of the t distribution, to which the calibration's own uncertainty contributes a mean of 0.
    No pair supports itself.

    Args:
        seen_cameras: (P,) camera of each projected 3D box.
        prior: (P, 2) variance of u and v by the calibration, pixels^2.
        matched: (T,) rows of the matched ones, each at most once.
        offsets_px: (T, 2) centre of the 2D box less that of the projected 3D box.
        variances: (T, 2) variances of the offsets, without `prior`.
        squared: (T,) squared distance of the 2D box, in standard deviations.

    Returns:
        (P, 2) shifts of u and v in pixels, and (P, 2) their variances.
    """
    weights = _weights(squared, variances)
    information = _sums_of_others(weights, matched, seen_cameras)
    left = prior / (1 + prior * information)
    return left * _sums_of_others(weights * offsets_px, matched, seen_cameras), left


def _weights(squared: F64, variances: F64) -> F64:
    """(T, D) weights of differences with variances (T, D), in pairs with squared distances (T,)."""
    return np.asarray((FREEDOM + 4) / (FREEDOM + squared)[:, None] / variances)


def _sums_of_others(values: F64, matched: I64, groups: I64) -> F64:
    """(P, ...) sums of contributions (T, ...) over the other pairs of the group (P,) of each rectangle.

    `matched` (T,) is the rectangle of each pair, each at most once.
    """
    total = np.zeros((groups.max(initial=-1) + 1, *values.shape[1:]))
    np.add.at(total, groups[matched], values)
    others = total[groups]
    others[matched] -= values
    return others


def _log_given(log_classes: F64, confusion: F64) -> F64:
    """(P, K) log probability of each class by a 2D detector, from that of each true class."""
    return np.log(softmax(log_classes) @ confusion)
