"""How sure the place of an object is, as an ellipse on the ground."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D

__all__ = ["CORNERS", "ground_ellipses"]

CORNERS = 48
"""Of the polygon that is drawn as an ellipse."""

_ANGLES = np.arange(CORNERS) * (2 * np.pi / CORNERS)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def ground_ellipses(boxes: Boxes3D) -> F64:
    """(N, CORNERS, 3) points of one standard deviation around the middle of each box's bottom, metres.

    They are the places c + L u of all unit vectors u, where L L^T is the covariance of x and y; all at the middle where
    that is unknown.
    """
    xx, xy, yy = boxes.covariances[:, 0, 0], boxes.covariances[:, 0, 1], boxes.covariances[:, 1, 1]
    along_x = np.sqrt(np.maximum(xx, 0.0))
    shear = np.divide(xy, along_x, out=np.zeros_like(xy), where=along_x > 0)
    along_y = np.sqrt(np.maximum(yy - shear**2, 0.0))
    points = np.repeat(boxes.centers[:, None], CORNERS, 1)
    points[..., 0] += along_x[:, None] * _CIRCLE[0]
    points[..., 1] += shear[:, None] * _CIRCLE[0] + along_y[:, None] * _CIRCLE[1]
    points[..., 2] -= boxes.sizes[:, None, 2] / 2
    return points
