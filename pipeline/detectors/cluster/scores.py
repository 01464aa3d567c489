"""How much speaks for a completed box, and how well its place is known."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.detectors.cluster.completion import CompletedBoxes
from lidcam.pipeline.detectors.cluster.lshape import Rectangles

FULL_VIEW_SHARE = 0.25
"""An object that returns this share of the points expected in full view gets half of the best score: black paint
returns little, and other objects stand in front."""

ROUGH_SHARE = 0.15
"""A residual of this share of the box's mean side takes the score down to 1/e: bushes are rough, vehicles are not."""

SIZE_STD_SHARE, SPACING_STD_SHARE, ROUGH_STD_SHARE = 0.03, 0.3, 0.6
"""Standard deviation of a centre beside that of its growth: shares of the box's extent, of the distance between beams
on a side that faces the lidars, and of the residual of the sides. See `box_covariances`."""

YAW_SPACING_SHARE = 0.15
"""Standard deviation of where a side stands at its ends, as a share of the distance between beams, beside the residual
of the sides: over the side's length this turns it."""

ROUND_YAW_RAD = 0.7
"""Standard deviation of a rider's heading, which is that of the principal axis of its points, where their variances
across and along that axis are as 1 to 2. In general it is this times v / (1 - v) with the ratio v of the variances."""

YAW_STD_MIN_RAD = np.deg2rad(1.0)
YAW_STD_MAX_RAD = np.pi / np.sqrt(12.0)
"""Where the heading is not known at all: of a line, anything within half a turn alike."""

ROUND_FROM, ROUND_TO = 0.5, 0.8
"""Ratio of width to length of a box from which on the points say less about its heading, and nothing."""

RIDER_FROM, RIDER_TO = 1.05, 0.95
"""Ratio of the length that was seen of a rider to the width from which on down the points say less about the heading,
and nothing: they are those of shoulders, which lie across it. In simulated recordings of a crossing, of riders of whom
less was seen, every third heading was off by more than 60 degrees; of whom more was seen, none of 330."""


def box_scores(boxes: CompletedBoxes, rectangles: Rectangles, counts: I64, expected_per_m2: F64) -> F64:
    """(C,) in [0, 1], by the share of the expected points, the smoothness of the sides and the fit to the size prior.

    Args:
        boxes: Completed boxes of C clusters.
        rectangles: Their measured extents.
        counts: (C,) points of each cluster.
        expected_per_m2: (C,) points to expect on a square metre that faces the lidars.
    """
    full_view = counts / np.maximum(expected_per_m2 * boxes.faces_m2, 1e-9)
    evidence = full_view / (full_view + FULL_VIEW_SHARE)
    smooth = np.exp(-rectangles.residual_m / (ROUGH_SHARE * np.sqrt(boxes.sizes[:, 0] * boxes.sizes[:, 1])))
    return np.where(boxes.class_ids >= 0, evidence * smooth * np.exp(-boxes.misfit / 4), 0.0)


def box_covariances(boxes: CompletedBoxes, rectangles: Rectangles, roundness: F64, expected_per_m2: F64) -> F64:
    """(C, 3, 3) over x, y and yaw: independent errors along length, width and heading.

    Yaw is that of the length, of which the lidars do not know the front: half a turn is no error here. The centre is
    where the object was when it was measured: what it moves until the frame's time comes on top.

    The shares were fitted by maximum likelihood to simulated recordings of a crossing and of a drive, on boxes of the
    right class. Squared errors of x and y against the covariance, where 2 is exact, are there 1.4 and 3.6 for cars, 0.8
    and 1.9 for cyclists, 0.5 and 2.0 for pedestrians, 0.3 to 2.2 for vans, trucks and buses, 4.9 for the cars of five
    KITTI frames; those of yaw, where 1 is exact, 0 to 4, but for single cars of few points whose heading is wrong.

    Args:
        boxes: Completed boxes of C clusters.
        rectangles: Their measured extents.
        roundness: (C,) of their points, see `principal_axes`.
        expected_per_m2: (C,) points to expect on a square metre that faces the lidars.
    """
    spacing_m = 1 / np.sqrt(np.maximum(expected_per_m2, 1e-9))
    extent = rectangles.high - rectangles.low
    noise = (SPACING_STD_SHARE * spacing_m) ** 2 + (ROUGH_STD_SHARE * rectangles.residual_m) ** 2
    variance = boxes.center_std_m**2 + (SIZE_STD_SHARE * boxes.sizes[:, :2]) ** 2 + noise[:, None]
    rotations = rotations_2d(boxes.yaw_rad)
    covariances = np.zeros((len(variance), 3, 3))
    covariances[:, :2, :2] = rotations @ (variance[:, :, None] * rotations.transpose(0, 2, 1))
    covariances[:, 2, 2] = _yaw_std(boxes, extent, rectangles.residual_m, roundness, spacing_m) ** 2
    return covariances


def _yaw_std(boxes: CompletedBoxes, extent: F64, residual_m: F64, roundness: F64, spacing_m: F64) -> F64:
    long_m = np.maximum(extent.max(1), 1e-3)
    turn = np.hypot(residual_m, YAW_SPACING_SHARE * spacing_m) / long_m
    by_axis = ROUND_YAW_RAD * roundness**2 / np.maximum(1 - roundness**2, 1e-3)
    turn = np.where(boxes.rides, np.maximum(turn, by_axis), turn)
    ratio = boxes.sizes[:, :2].min(1) / boxes.sizes[:, :2].max(1)
    unknown = np.clip((ratio - ROUND_FROM) / (ROUND_TO - ROUND_FROM), 0, 1)
    seen_m = boxes.sizes[:, 0] - 4 * boxes.center_std_m[:, 0]  # the rest was completed, to both ends alike
    short = np.clip((seen_m / boxes.sizes[:, 1] - RIDER_FROM) / (RIDER_TO - RIDER_FROM), 0, 1)
    unknown = YAW_STD_MAX_RAD * np.where(boxes.rides, np.maximum(unknown, short), unknown)
    return np.asarray(np.clip(np.hypot(turn, unknown), YAW_STD_MIN_RAD, YAW_STD_MAX_RAD))
