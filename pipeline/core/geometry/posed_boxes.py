"""Boxes of any orientation in any frame, as upright boxes of the site."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, CheckedTable
from lidcam.pipeline.core.geometry.boxes import wrap_angle

_FROM_Z = np.array([2, 1, 0])
"""Axes of a box in the order in which they are asked whether they point up: of equally steep ones z is taken."""

STEEPER = 1e-9
"""Least margin by which another axis must be steeper than z: rounding must not turn a side into the top."""

POSITION_SIGMA_M = 0.3
"""Standard deviation of x and of y of a box without their covariance."""

YAW_SIGMA_RAD = np.radians(10.0)
"""Standard deviation of the heading of a box without its variance."""

MAX_VARIANCE = 1e12
"""m^2, rad^2: a covariance with larger numbers says nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedBoxes(CheckedTable):
    """Boxes of any orientation."""

    ROWS: ClassVar = {"centers": (3,), "rotations": (3, 3), "sizes": (3,), "covariances": (6, 6)}

    centers: F64  # (N, 3) float64, metres in some frame
    rotations: F64  # (N, 3, 3) float64, R_frame_box: its columns are the axes of the box in that frame
    sizes: F64  # (N, 3) float64, along the box's own x, y, z, metres
    # (N, 6, 6) float64 over the position (m^2) and small rotations about the axes of that frame (rad^2), as in
    # geometry_msgs/PoseWithCovariance; what is not known is zero or not finite
    covariances: F64


class UprightBoxes(NamedTuple):
    """Boxes with a vertical axis."""

    centers: F64  # (N, 3) float64, metres
    sizes: F64  # (N, 3) float64, length, width, height, metres
    yaws: F64  # (N,) float64 about +z, in (-pi, pi]
    covariances: F64  # (N, 3, 3) float64 over x, y (m^2) and yaw (rad^2)


def upright_boxes(boxes: PosedBoxes, T_site_frame: F64) -> UprightBoxes:
    """Boxes of a frame as boxes of the site whose height is vertical; `T_site_frame` is (4, 4).

    The axis of a box that is nearest to the vertical becomes its height: its own z, or another one where the frame's z
    does not point up, as that of a camera. Of the other two the first is its length (x before y before z), and the
    length's direction on the ground is the heading. The box keeps its size: a tilt is taken for that of the sensor or
    the road.
    """
    rotation, rows = T_site_frame[:3, :3], np.arange(len(boxes))
    # einsum and not BLAS: the result must not depend on the number of boxes or the machine.
    centers = np.einsum("ij,nj->ni", rotation, boxes.centers) + T_site_frame[:3, 3]
    axes = np.einsum("ij,njk->nik", rotation, boxes.rotations)
    steepness = np.abs(axes[:, 2, _FROM_Z])
    steepness[:, 0] += STEEPER
    up = _FROM_Z[steepness.argmax(1)]
    along, across = np.where(up == 0, 1, 0), np.where(up == 2, 1, 2)
    yaws = np.arctan2(axes[rows, 1, along], axes[rows, 0, along])
    sizes = np.stack([boxes.sizes[rows, along], boxes.sizes[rows, across], boxes.sizes[rows, up]], -1)
    covariances = _over_x_y_yaw(boxes.covariances, rotation)
    return UprightBoxes(centers, sizes, wrap_angle(yaws), _with_defaults(covariances))


def _over_x_y_yaw(covariances: F64, rotation: F64) -> F64:
    """(N, 3, 3) over x, y and yaw of the site, symmetric; zeros where a number is not finite or too large."""
    jacobian = np.zeros((3, 6))
    jacobian[:2, :3], jacobian[2, 3:] = rotation[:2], rotation[2]
    is_sane = (np.isfinite(covariances) & (np.abs(covariances) <= MAX_VARIANCE)).all((1, 2), keepdims=True)
    sane = np.where(is_sane, covariances, 0.0)
    turned = np.einsum("ai,nij,bj->nab", jacobian, (sane + sane.transpose(0, 2, 1)) / 2, jacobian)
    return np.asarray((turned + turned.transpose(0, 2, 1)) / 2, np.float64)


def _with_defaults(covariances: F64) -> F64:
    """Covariances that are positive definite: what is not is replaced, and then not correlated with the rest."""
    found = covariances.copy()
    has_position = (found[:, 0, 0] > 0) & (found[:, 0, 0] * found[:, 1, 1] > found[:, 0, 1] ** 2)
    has_yaw = found[:, 2, 2] > 0
    is_apart = ~(has_position & has_yaw & (np.linalg.det(found) > 0))
    found[is_apart, :2, 2] = found[is_apart, 2, :2] = 0.0
    found[~has_position, :2, :2] = POSITION_SIGMA_M**2 * np.eye(2)
    found[~has_yaw, 2, 2] = YAW_SIGMA_RAD**2
    return found
