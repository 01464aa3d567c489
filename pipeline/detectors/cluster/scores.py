"""Scores and covariances of completed boxes."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.detectors.cluster.completion import CompletedBoxes
from lidcam.pipeline.detectors.cluster.lshape import Rectangles

FULL_VIEW_SHARE = 0.25
"""Share of the points expected in full view that gives half of the best score: black paint returns little, and other
objects stand in front."""

ROUGH_SHARE = 0.15
"""Residual that takes the score down to 1/e, as a share of the box's mean side: bushes are rough, vehicles are not."""

SIZE_STD_SHARE = 0.03
"""Standard deviation of a centre, as a share of the box's extent; with that of its growth and the next two."""

SPACING_STD_SHARE = 0.3
"""Standard deviation of a centre, as a share of the distance between beams on a side that faces the lidars."""

ROUGH_STD_SHARE = 0.6
"""Standard deviation of a centre, as a share of the residual of the sides."""

YAW_SPACING_SHARE = 0.15
"""Standard deviation of the ends of a side, as a share of the distance between beams; with the residual of the sides it
turns the heading."""

ROUND_YAW_RAD = 0.7
"""Standard deviation of a rider's heading, that of the principal axis of its points, where their variances across and
along that axis are as 1 to 2. In general it is this times v / (1 - v) with the ratio v of the variances."""

MIN_YAW_STD_RAD = np.deg2rad(1.0)

MAX_YAW_STD_RAD = np.pi / np.sqrt(12.0)
"""Standard deviation of an unknown heading: of a line, anything within half a turn alike."""

ROUND_FROM, ROUND_TO = 0.5, 0.8
"""Ratios of width to length of a box between which the points say less and less about its heading, to nothing."""

RIDER_FROM, RIDER_TO = 1.05, 0.95
"""Ratios of the length that was seen of a rider to the width between which, downwards, the points say less and less
about the heading: they are those of shoulders, which lie across it."""


def box_scores(boxes: CompletedBoxes, rectangles: Rectangles, counts: I64, expected_per_m2: F64) -> F64:
    """(C,) in [0, 1], by the share of the expected points, the smoothness of the sides and the fit to the size prior.

    Args:
        boxes: Completed boxes of C clusters.
        rectangles: Measured extents of the clusters.
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
    right class.

    Args:
        boxes: Completed boxes of C clusters.
        rectangles: Measured extents of the clusters.
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
    unknown = MAX_YAW_STD_RAD * np.where(boxes.rides, np.maximum(unknown, short), unknown)
    return np.asarray(np.clip(np.hypot(turn, unknown), MIN_YAW_STD_RAD, MAX_YAW_STD_RAD))
