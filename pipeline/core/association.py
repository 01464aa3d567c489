"""How likely a projected 3D box and a 2D box show one object.

A rectangle counts as four numbers: its centre in pixels and the logarithms of its width and height. Their differences
are compared with what the covariance of the 3D box, the 2D detector and the calibration allow, by a multivariate t
distribution: a 2D box around a part of an object lies far out, and still is that object's. Against this stands that the
2D box belongs to something else, which may lie anywhere in the image and be of any class. The logarithm of the ratio of
both is what a pair is worth, and the pairs with the largest sum are the likeliest together (Blackman and Popoli, Design
and Analysis of Modern Tracking Systems, 1999, chapter 6).

Detectors confuse classes of similar size: a truck is called a bus, a rider a pedestrian. So the sizes of the configured
classes say how likely each confusion is.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.fuse import AssociateConfig

FREEDOM = 4.0
"""Degrees of freedom of the t distribution."""

_LOG_PEAK = np.log(FREEDOM / 2 * (FREEDOM / 2 + 1)) - 2 * np.log(np.pi * FREEDOM)
"""Logarithm of its density in the middle, in four dimensions, for a covariance of determinant 1."""

LOG_SIZES = 4.0
"""Widths, and heights, of things in images spread over this range of logarithms: from 10 to 550 pixels."""

ALIKE = 0.6
"""Difference of the sizes (root of the summed squares of the logarithms of the ratios of length, width and height) at
which two classes are confused 0.6 times as often as classes of equal size."""


def rectangle_features(xyxy: F32) -> F64:
    """(P, 4) u, v of the centre in pixels, logarithms of width and height; sides under a pixel count as one."""
    edges = xyxy.astype(np.float64)
    return np.concatenate([(edges[:, :2] + edges[:, 2:]) / 2, np.log(_extent(edges))], 1)


def detector_variances(xyxy: F32, config: AssociateConfig) -> F64:
    """(P, 4) variances of the features of 2D boxes that show what is projected to rectangles, by a sound calibration.

    Args:
        xyxy: (P, 4) the rectangles, pixels.
        config: Standard deviations.
    """
    extent = _extent(xyxy.astype(np.float64))
    edge = config.pixel_sigma_px**2 + (config.outline_sigma * extent) ** 2
    return np.concatenate([edge / 2, 2 * edge / extent**2], 1)


def squared_distances(differences: F64, variances: F64) -> F64:
    """(Q,) squared distances in standard deviations, of differences of features (Q, 4)."""
    # Added in this order on every machine.
    a, b, c, d = (differences * differences / variances).T
    return np.asarray(a + b + c + d)


def fit_ratios(squared: F64, variances: F64, area_px: F64, unseen_boxes: float) -> F64:
    """How much likelier the places of pairs are if they show one object than if they do not.

    Args:
        squared: (Q,) `squared_distances` of the 2D box from the projected 3D box.
        variances: (Q, 4) of the features if both show one object.
        area_px: (Q,) area of the image.
        unseen_boxes: Expected number of 2D boxes in an image that belong to no 3D box.

    Returns:
        (Q,) logarithms of the ratio.
    """
    a, b, c, d = variances.T
    peak = _LOG_PEAK - 0.5 * np.log(a * b * c * d)
    elsewhere = np.log(unseen_boxes / LOG_SIZES**2) - np.log(area_px)
    return np.asarray(peak - (FREEDOM / 2 + 2) * np.log1p(squared / FREEDOM) - elsewhere)


def class_confusion(classes: Sequence[ClassPrior], any_class: float) -> F64:
    """(K, K) probability that a detector calls an object of the row's class by the column's; rows sum to 1.

    Args:
        classes: K classes.
        any_class: Share of the calls that have nothing to do with the object's class.
    """
    alike = np.exp(-class_distances(classes) / ALIKE**2 / 2)
    return np.asarray((1 - any_class) * alike / alike.sum(1, keepdims=True) + any_class / len(classes))


def class_agreement(classes: Sequence[ClassPrior], riders: frozenset[tuple[int, int]] = frozenset()) -> F64:
    """(K, K) log likelihood ratio of a 2D box of the column's class, against one of the right class, for each object.

    The less two classes are alike, the less a box of the one says of an object of the other. This falls faster than
    `class_confusion`, by which boxes are matched: here, a car is not to be confirmed by a pedestrian.

    Args:
        classes: K classes.
        riders: Pairs of a class that is ridden, and one that the detector may call its riders (`Detect2D.riders`).
    """
    agreement = -class_distances(classes) / ALIKE**2
    for ridden, person in riders:
        agreement[ridden, person] = 0.0
    return np.asarray(agreement)


def class_distances(classes: Sequence[ClassPrior]) -> F64:
    """(K, K) how much classes differ in size: sum of the squared logarithms of the ratios of length, width, height."""
    sizes = np.log(np.array([prior.size_m for prior in classes]))
    return np.asarray(((sizes[:, None] - sizes) ** 2).sum(-1))


def _extent(edges: F64) -> F64:
    """(P, 2) width and height, at least a pixel."""
    return np.maximum(edges[:, 2:] - edges[:, :2], 1.0)
