"""How much speaks for a completed box, and how well its place is known."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.geometry.boxes import rotations_2d
from pipeline.detectors.cluster.completion import CompletedBoxes
from pipeline.detectors.cluster.lshape import Rectangles

__all__ = ["box_covariances", "box_scores"]


FULL_VIEW_SHARE = 0.25
"""An object that returns this share of the points expected in full view gets half of the best score: black paint
returns little, and other objects stand in front."""

ROUGH_SHARE = 0.15
"""A residual of this share of the box's mean side takes the score down to 1/e: bushes are rough, vehicles are not."""

SURFACE_STD_SHARE = 0.05
"""Standard deviation of a seen side's position, as a share of the box's width."""

YAW_STD_MIN_RAD = np.deg2rad(1.0)
YAW_STD_MAX_RAD = np.pi / 4


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


def box_covariances(boxes: CompletedBoxes, rectangles: Rectangles) -> F64:
    """(C, 3, 3) over x, y and yaw: independent errors along length, width and heading."""
    variance = boxes.center_std_m**2 + (SURFACE_STD_SHARE * boxes.sizes[:, 1:2]) ** 2
    rotations = rotations_2d(boxes.yaw_rad)
    long_m = np.maximum((rectangles.high - rectangles.low).max(1), 1e-3)
    yaw_std = np.clip(rectangles.residual_m / long_m, YAW_STD_MIN_RAD, YAW_STD_MAX_RAD)
    covariances = np.zeros((len(variance), 3, 3))
    covariances[:, :2, :2] = rotations @ (variance[:, :, None] * rotations.transpose(0, 2, 1))
    covariances[:, 2, 2] = yaw_std**2
    return covariances
