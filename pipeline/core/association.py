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

MIN_GIOU = -0.3
"""Smallest generalised IoU of a projected 3D box and a 2D box that may match, from -1 to 1. Below 0, boxes of small
objects may match that lie side by side, where the calibration is off."""

MAX_SIGMAS = 6.0
"""Largest distance of a pair that may match, in standard deviations."""

PIXEL_SIGMA_PX = 2.0
"""Standard deviation of the edges of 2D boxes. Larger than `fuse.pixel_sigma_px`: a wrong class or a hidden part moves
edges further, and such pairs should match as well."""

OUTLINE_SIGMA = 0.15
"""Standard deviation added to it, as a share of the width or height of the projected box, whose size may be wrong."""

CALIBRATION_SIGMA_RAD = np.deg2rad(0.5)
"""Standard deviation of the direction in which a camera looks."""

ANY_CLASS = 0.01
"""Share of the classes reported by detectors that say nothing of the object."""

UNSEEN_BOXES = 3.0
"""Expected number of 2D boxes in an image without a 3D box. The more there are, the better a pair has to fit."""

FREEDOM = 4.0
"""Degrees of freedom of the t distribution."""

_LOG_PEAK = np.log(FREEDOM / 2 * (FREEDOM / 2 + 1)) - 2 * np.log(np.pi * FREEDOM)
"""Log density at the mean of the t distribution, in four dimensions, for a covariance of determinant 1."""

LOG_SIZES = 4.0
"""Widths, and heights, of things in images spread over this range of logarithms: from 10 to 550 pixels."""

ALIKE = 0.6
"""Difference of the sizes (root of the summed squares of the logarithms of the ratios of length, width and height) at
which two classes are confused 0.6 times as often as classes of equal size."""


def rectangle_features(xyxy: F32) -> F64:
    """(P, 4) u, v of the centre in pixels, logarithms of width and height; sides under a pixel count as one."""
    edges = xyxy.astype(np.float64)
    return np.concatenate([(edges[:, :2] + edges[:, 2:]) / 2, np.log(_extent(edges))], 1)


def detector_variances(xyxy: F32) -> F64:
    """(P, 4) variances of the features of 2D boxes of objects at rectangles (P, 4), by a sound calibration."""
    extent = _extent(xyxy.astype(np.float64))
    edge = PIXEL_SIGMA_PX**2 + (OUTLINE_SIGMA * extent) ** 2
    return np.concatenate([edge / 2, 2 * edge / extent**2], 1)


def anywhere_variances(image_sizes: F64) -> F64:
    """(C, 4) variances of the features of boxes anywhere in images (C, 2), of any size: no position is less certain."""
    return np.column_stack([image_sizes**2, np.full((len(image_sizes), 2), LOG_SIZES**2)]) / 12


def squared_distances(differences: F64, variances: F64) -> F64:
    """(Q,) squared distances in standard deviations, of differences of features (Q, 4)."""
    # Added in this order on every machine.
    a, b, c, d = (differences * differences / variances).T
    return np.asarray(a + b + c + d)


def fit_ratios(squared: F64, variances: F64, area_px: F64) -> F64:
    """(Q,) log likelihood ratios of the places of pairs: one object against two.

    From the `squared_distances` (Q,) of 2D boxes from projected 3D boxes, the variances (Q, 4) of the features if both
    show one object, and the areas (Q,) of the images.
    """
    a, b, c, d = variances.T
    peak = _LOG_PEAK - 0.5 * np.log(a * b * c * d)
    elsewhere = np.log(UNSEEN_BOXES / LOG_SIZES**2) - np.log(area_px)
    return np.asarray(peak - (FREEDOM / 2 + 2) * np.log1p(squared / FREEDOM) - elsewhere)


def class_confusion(classes: Sequence[ClassPrior]) -> F64:
    """(K, K) probability that a detector calls an object of the row's class by the column's; rows sum to 1."""
    alike = np.exp(-class_distances(classes) / ALIKE**2 / 2)
    return np.asarray((1 - ANY_CLASS) * alike / alike.sum(1, keepdims=True) + ANY_CLASS / len(classes))


def class_agreement(classes: Sequence[ClassPrior], riders: frozenset[tuple[int, int]] = frozenset()) -> F64:
    """(K, K) log likelihood ratio of a 2D box of the column's class, against one of the right class, for each object.

    The less two classes are alike, the less a box of the one says of an object of the other. This falls faster than
    `class_confusion`, by which boxes are matched: here, a car is not to be confirmed by a pedestrian. `riders` are
    pairs of a class that is ridden, and one that the detector may call its riders (`Detect2D.riders`).
    """
    agreement = -class_distances(classes) / ALIKE**2
    for ridden, person in riders:
        agreement[ridden, person] = 0.0
    return np.asarray(agreement)


def class_distances(classes: Sequence[ClassPrior]) -> F64:
    """(K, K) differences of classes in size: sums of the squared log ratios of length, width, height."""
    sizes = np.log(np.array([prior.size_m for prior in classes]))
    return np.asarray(((sizes[:, None] - sizes) ** 2).sum(-1))


def _extent(edges: F64) -> F64:
    """(P, 2) width and height, at least a pixel."""
    return np.maximum(edges[:, 2:] - edges[:, :2], 1.0)
