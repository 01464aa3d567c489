"""Prior of a box before the images are used: covariances of its position, heading, size and speed."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.core.settings.fuse import FuseConfig

STATES = ("x", "y", "yaw", "length", "width", "height", "speed along", "speed across")
"""Order of the state: metres, radians, metres per second along the axes of the box."""

UNKNOWN_SIGMA = 0.1
"""Standard deviation of a position without covariance, as a share of the box's width."""

UNKNOWN_SIGMA_PER_M = 0.005
"""Additional standard deviation of such a position per metre from the lidars."""

LONG_YAW_SIGMA_RAD = 0.1
"""Standard deviation of a heading without covariance, for boxes longer than wide, radians."""

SQUARE_YAW_SIGMA_RAD = np.pi / 4
"""Standard deviation of a heading without covariance, for boxes as long as wide, radians."""

MIN_ELONGATION = 1.5
"""Minimum ratio of length to width of a box that shows its heading."""

MIN_SIGMA = 0.01
"""Minimum standard deviation of a position, as a share of the width."""

MIN_YAW_SIGMA_RAD = np.deg2rad(0.5)
"""Minimum standard deviation of a heading, radians."""

MAX_YAW_SIGMA_RAD = 0.6
"""Maximum standard deviation of a refined heading, radians; front and rear are not distinguished here."""

SEEN_SIZE_SIGMA = 0.03
"""Standard deviation of length and width whose both ends the lidars saw, as a share of them."""

CLASS_SIZE_SIGMA = 0.1
"""Standard deviation of length and width taken from the class, as a share of them."""

HIDDEN_TOP_SIGMA = 0.08
"""Standard deviation of the height of a box onto whose top no lidar looks down, as a share of it: the top is between
two beams, or above all of them."""

SEEN_TOP_SIGMA = 0.02
"""Standard deviation of the height of a box whose top a lidar sees from above, as a share of it."""

SEEN_TOP_RAD = np.deg2rad(5.0)
"""Minimum angle at which a lidar looks down on a top that it sees from above, radians."""

MAX_EXPLAINED = 0.95
"""Maximum share of the variance of the centre that comes from an unknown length or width."""

MIN_ANCHOR = 0.25
"""Minimum lever between size and centre: with both ends seen, the length errs by at most four times the centre."""

MAX_SIZE_SIGMA = 0.15
"""Maximum standard deviation of length and width of a box, as a share of them."""

HEADING_SIGMA_RAD = np.deg2rad(5.0)
"""Standard deviation of the heading that images show, radians: a cuboid fitted to an object is turned."""

SPEED_SIGMA_PER_S = 2.5
"""Standard deviation of the speed along the box, in geometric means of length and width per second: 6.5 m/s for a car,
1.5 m/s for a pedestrian."""


class BoxPrior(NamedTuple):
    """Independent normal distributions of N boxes over `STATES`.

    The yaw among them is the apparent one in images. A cuboid fitted to another shape is turned alike in all images, so
    the box follows the apparent yaw by a share.
    """

    covariances: F64  # (N, 8, 8) float64
    information: F64  # (N, 8, 8) float64, their inverses
    yaw_shares: F64  # (N,) float64 in [0, 1], share by which the yaw of a box follows the apparent one
    yaw_rests: F64  # (N,) float64, variance of the yaw of a box given the apparent one, rad^2


def known_covariances(boxes: Boxes3D, lidar_xy: F64) -> F64:
    """(N, 3, 3) covariances of x, y (m^2) and yaw (rad^2), guessed by size and distance where unknown.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres; there may be none.
    """
    is_known = (boxes.covariances != 0).any((1, 2), keepdims=True)
    length, width = boxes.sizes[:, :2].max(1), boxes.sizes[:, :2].min(1)
    range_m = np.linalg.norm(boxes.centers[:, None, :2] - lidar_xy, axis=2).min(1) if len(lidar_xy) else 0.0
    elongation = ((length / width - 1) / (MIN_ELONGATION - 1)).clip(0.0, 1.0)
    guess = np.zeros(boxes.covariances.shape)
    guess[:, 0, 0] = guess[:, 1, 1] = (UNKNOWN_SIGMA * width + UNKNOWN_SIGMA_PER_M * range_m) ** 2
    guess[:, 2, 2] = (SQUARE_YAW_SIGMA_RAD + elongation * (LONG_YAW_SIGMA_RAD - SQUARE_YAW_SIGMA_RAD)) ** 2
    return np.where(is_known, boxes.covariances, guess)


def box_prior(boxes: Boxes3D, lidar_xyz: F64, config: FuseConfig) -> BoxPrior:
    """The distributions of boxes.

    A box whose far side no lidar saw has the length of its class, and grows away from the lidars: if it is longer, its
    centre is farther away. So length and centre are correlated as far as the lidars are beyond one end of the box. The
    smaller of the size variances by the covariance and by `MAX_SIZE_SIGMA` holds.

    Args:
        boxes: N boxes.
        lidar_xyz: (L, 3) positions of the lidars, metres.
        config: `lidar_sigma_scale`, for boxes that the lidars see.
    """
    lidar_xy = lidar_xyz[:, :2]
    extents, is_seen = boxes.sizes[:, :2], boxes.sources != Source.CAMERA.value
    scale = np.where(is_seen, config.lidar_sigma_scale**2, 1.0)
    known = known_covariances(boxes, lidar_xy) * scale[:, None, None]
    # The 2D boxes that placed an object show its direction, and are measured again: only the size of its error counts.
    placed = np.flatnonzero(~is_seen)
    known[placed, :2, :2] = known[placed][:, [0, 1], [0, 1]].sum(1)[:, None, None] * np.eye(2)
    yaw_variances = known[:, 2, 2].clip(MIN_YAW_SIGMA_RAD**2, MAX_YAW_SIGMA_RAD**2)
    shrunk = np.ones((len(boxes), 3))
    shrunk[:, 2] = np.sqrt(yaw_variances / np.maximum(known[:, 2, 2], 1e-12))
    pose = shrunk[:, :, None] * known * shrunk[:, None]
    pose[:, 2, 2] = yaw_variances
    pose[:, [0, 1], [0, 1]] += (MIN_SIGMA * extents.min(1, keepdims=True)) ** 2

    # Different variances along length and width come from an unseen side, so from the size.
    turn = rotations_2d(boxes.yaws)
    left = _free_variances(pose, turn)
    anchors = np.where(is_seen[:, None], _nearer_ends(boxes, lidar_xy, turn) / 2, 0.0)
    grown = np.minimum(left - left.min(1, keepdims=True), MAX_EXPLAINED * left)
    reach = np.maximum(np.abs(anchors), MIN_ANCHOR)
    max_share = MAX_SIZE_SIGMA**2
    min_share = np.minimum(np.where(is_seen, SEEN_SIZE_SIGMA, CLASS_SIZE_SIGMA)[:, None] ** 2, max_share)
    sizes = np.maximum(np.minimum(max_share, grown / (reach * extents) ** 2), np.maximum(min_share, 1e-6)) * extents**2
    sizes = np.minimum(sizes, np.maximum(MAX_EXPLAINED * left / np.maximum(anchors**2, 1e-9), 1e-6 * extents**2))
    too_wide = np.where(np.abs(anchors) > MIN_ANCHOR, np.maximum(grown - anchors**2 * sizes, 0.0), 0.0)
    shared = anchors * sizes
    # Even the minimum variance of the size may exceed the centre's.
    max_shared = np.copysign(np.sqrt(MAX_EXPLAINED * left * sizes), anchors)
    shared = np.where(anchors * shared > left, max_shared, shared)
    pose[:, :2, :2] -= (turn * too_wide[:, None]) @ turn.swapaxes(1, 2)

    covariances = np.zeros((len(boxes), 8, 8))
    covariances[:, :3, :3] = pose
    covariances[:, :2, 3:5] = -turn * shared[:, None]
    covariances[:, 3:5, :2] = covariances[:, :2, 3:5].swapaxes(1, 2)
    covariances[:, [3, 4], [3, 4]] = sizes
    height_sigmas = np.where(is_seen, _height_sigmas(boxes, lidar_xyz), CLASS_SIZE_SIGMA)
    covariances[:, 5, 5] = (height_sigmas * boxes.sizes[:, 2]) ** 2
    speed = SPEED_SIGMA_PER_S * np.sqrt(extents.prod(1))
    covariances[:, 6, 6], covariances[:, 7, 7] = speed**2, (speed * extents.min(1) / extents.max(1)) ** 2
    covariances[:, 2, 2] += HEADING_SIGMA_RAD**2
    yaw_shares = yaw_variances / covariances[:, 2, 2]
    return BoxPrior(
        covariances, np.asarray(np.linalg.inv(covariances), np.float64), yaw_shares, yaw_variances * (1 - yaw_shares)
    )


def _height_sigmas(boxes: Boxes3D, lidar_xyz: F64) -> F64:
    """(N,) standard deviations of the heights of boxes that lidars see, as shares of them."""
    above_m = lidar_xyz[:, 2] - (boxes.centers[:, 2:] + boxes.sizes[:, 2:] / 2)
    away_m = np.linalg.norm(lidar_xyz[:, :2] - boxes.centers[:, None, :2], axis=2)
    down_rad = np.arctan2(above_m, away_m).max(1, initial=0.0)
    return np.asarray(np.interp(down_rad, [0.0, SEEN_TOP_RAD], [HIDDEN_TOP_SIGMA, SEEN_TOP_SIGMA]))


def _free_variances(pose: F64, turn: F64) -> F64:
    """(N, 2) variances of the centre along length and width, independent of the yaw and of each other.

    The covariances (N, 3, 3) of x, y, yaw less these have no negative eigenvalues.
    """
    by_yaw = pose[:, :2, 2]
    place = pose[:, :2, :2] - by_yaw[:, :, None] * by_yaw[:, None] / pose[:, 2, 2, None, None]
    along_box = turn.swapaxes(1, 2) @ place @ turn
    variances = np.maximum(np.diagonal(along_box, axis1=1, axis2=2), 1e-12)
    both = np.abs(along_box[:, 0, 1])[:, None]
    return np.asarray(np.maximum(variances - both * np.sqrt(variances / variances[:, ::-1]), 0.0))


def _nearer_ends(boxes: Boxes3D, lidar_xy: F64, turn: F64) -> F64:
    """(N, 2) along length and width: 1 where all lidars are beyond the front or left end, -1 the other, 0 beside.

    Lidars weigh by the inverse square of their distance, as their points do.
    """
    if not len(lidar_xy):
        return np.zeros((len(boxes), 2))
    gap = lidar_xy - boxes.centers[:, None, :2]
    weights = 1 / np.maximum((gap * gap).sum(2), 1e-3)
    ends = (gap @ turn / (boxes.sizes[:, None, :2] / 2)).clip(-1.0, 1.0)
    return np.asarray((weights[..., None] * ends).sum(1) / weights.sum(1, keepdims=True))
