"""Prior of a box before the images are used: means and covariances of its place, heading, size and speed."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D, Source
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.core.settings.fuse import FuseConfig

STATES = ("x", "y", "yaw", "length", "width", "speed along", "speed across")
"""Order of the state: metres, radians, metres per second along the axes of the box."""

UNKNOWN_SHARE, UNKNOWN_PER_M = 0.1, 0.005
"""Standard deviation of a place without covariance: a share of the box's width, and of the distance from the lidars."""

UNKNOWN_YAW_RAD, ANY_YAW_RAD = 0.1, np.pi / 4
"""Standard deviation of a heading without covariance, where length and width differ much, and where they are equal."""

SQUARE = 1.5
"""Length by width from which on the heading of a box shows."""

MIN_SHARE, MIN_RAD = 0.01, np.deg2rad(0.5)
"""Smallest standard deviations, of the place as a share of the width: boxes are not known better."""

MAX_YAW_RAD = 0.6
"""Largest standard deviation of a heading that is refined; front and rear are not told apart here."""

SEEN_SHARE = 0.03
"""Standard deviation of a length, and a width, of which lidars saw both ends, as a share of it."""

MAX_EXPLAINED = 0.95
"""Largest share of the variance of the centre that comes from an unknown length, or width."""

MIN_ANCHOR = 0.25
"""Where lidars see both ends, the length errs by four times the error of the centre at most."""

MAX_SIZE_SHARE = 0.15
"""Largest standard deviation of length and width of a box, as a share of them."""

HEADING_SIGMA_RAD = np.deg2rad(5.0)
"""Standard deviation of the heading that images show: objects are no cuboids, and a fitted cuboid is turned."""

CLASS_SHARE = 0.1
"""Standard deviation of length and width of a box that has those of its class, as a share of them."""

SPEED_PER_S = 2.5
"""Standard deviation of the speed along the box, in geometric means of its length and width per second: 6.5 m/s for a
car, 1.5 m/s for a pedestrian, and as much less in a model."""


class BoxPrior(NamedTuple):
    """Independent normal distributions of N boxes over `STATES`.

    The yaw among them is the one that images show. A cuboid fitted to what is no cuboid is turned, in all images alike:
    of what the images say of the yaw, the box takes a share.

    Attributes:
        covariances: (N, 7, 7) float64.
        information: (N, 7, 7) float64, their inverses.
        yaw_shares: (N,) float64 in [0, 1], how far the yaw of a box follows the one that images show.
        yaw_rests: (N,) float64, variance of the yaw of a box if the one that images show is known, rad^2.
    """

    covariances: F64
    information: F64
    yaw_shares: F64
    yaw_rests: F64


def known_covariances(boxes: Boxes3D, lidar_xy: F64) -> F64:
    """(N, 3, 3) covariances of x, y (m^2) and yaw (rad^2); a guess by size and distance where they are unknown.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres; there may be none.
    """
    is_known = (boxes.covariances != 0).any((1, 2))
    if is_known.all():
        return boxes.covariances
    length, width = boxes.sizes[:, :2].max(1), boxes.sizes[:, :2].min(1)
    away_m = np.linalg.norm(boxes.centers[:, None, :2] - lidar_xy, axis=2).min(1) if len(lidar_xy) else 0.0
    shows = ((length / width - 1) / (SQUARE - 1)).clip(0.0, 1.0)
    guess = np.zeros(boxes.covariances.shape)
    guess[:, 0, 0] = guess[:, 1, 1] = (UNKNOWN_SHARE * width + UNKNOWN_PER_M * away_m) ** 2
    guess[:, 2, 2] = (ANY_YAW_RAD + shows * (UNKNOWN_YAW_RAD - ANY_YAW_RAD)) ** 2
    return np.where(is_known[:, None, None], boxes.covariances, guess)


def box_prior(boxes: Boxes3D, lidar_xy: F64, config: FuseConfig) -> BoxPrior:
    """The distributions of boxes.

    A box whose far side no lidar saw has the length of its class, and grows away from the lidars: if it is longer, its
    centre is farther away. So length and centre are correlated as far as the lidars are beyond one end of the box. If
    the covariance allows for more than `MAX_SIZE_SHARE` does, it is the smaller one that holds.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres.
        config: `lidar_sigma_scale`.
    """
    extents, is_seen = boxes.sizes[:, :2], boxes.sources != Source.CAMERA.value
    known = known_covariances(boxes, lidar_xy) * config.lidar_sigma_scale**2
    yaw_variances = known[:, 2, 2].clip(MIN_RAD**2, MAX_YAW_RAD**2)
    shrunk = np.ones((len(boxes), 3))
    shrunk[:, 2] = np.sqrt(yaw_variances / np.maximum(known[:, 2, 2], 1e-12))
    pose = shrunk[:, :, None] * known * shrunk[:, None]
    pose[:, 2, 2] = yaw_variances
    pose[:, [0, 1], [0, 1]] += (MIN_SHARE * extents.min(1, keepdims=True)) ** 2

    # A side that no lidar saw makes the variances along length and width differ: that comes from the size.
    turn = rotations_2d(boxes.yaws)
    left = _free_variances(pose, turn)
    anchors = np.where(is_seen[:, None], _nearer_ends(boxes, lidar_xy, turn) / 2, 0.0)
    grown = np.minimum(left - left.min(1, keepdims=True), MAX_EXPLAINED * left)
    reach = np.maximum(np.abs(anchors), MIN_ANCHOR)
    max_share = MAX_SIZE_SHARE**2
    min_share = np.minimum(np.where(is_seen, SEEN_SHARE, CLASS_SHARE)[:, None] ** 2, max_share)
    sizes = np.maximum(np.minimum(max_share, grown / (reach * extents) ** 2), np.maximum(min_share, 1e-6)) * extents**2
    sizes = np.minimum(sizes, np.maximum(MAX_EXPLAINED * left / np.maximum(anchors**2, 1e-9), 1e-6 * extents**2))
    too_wide = np.where(np.abs(anchors) > MIN_ANCHOR, np.maximum(grown - anchors**2 * sizes, 0.0), 0.0)
    shared = anchors * sizes
    # Even the smallest variance of the size may be more than the centre's.
    most = np.copysign(np.sqrt(MAX_EXPLAINED * left * sizes), anchors)
    shared = np.where(anchors * shared > left, most, shared)
    pose[:, :2, :2] -= (turn * too_wide[:, None]) @ turn.swapaxes(1, 2)

    covariances = np.zeros((len(boxes), 7, 7))
    covariances[:, :3, :3] = pose
    covariances[:, :2, 3:5] = -turn * shared[:, None]
    covariances[:, 3:5, :2] = covariances[:, :2, 3:5].swapaxes(1, 2)
    covariances[:, [3, 4], [3, 4]] = sizes
    speed = SPEED_PER_S * np.sqrt(extents.prod(1))
    covariances[:, 5, 5], covariances[:, 6, 6] = speed**2, (speed * extents.min(1) / extents.max(1)) ** 2
    covariances[:, 2, 2] += HEADING_SIGMA_RAD**2
    yaw_shares = yaw_variances / covariances[:, 2, 2]
    return BoxPrior(
        covariances, np.asarray(np.linalg.inv(covariances), np.float64), yaw_shares, yaw_variances * (1 - yaw_shares)
    )


def _free_variances(pose: F64, turn: F64) -> F64:
    """(N, 2) variances of the centre along length and width that are independent of the yaw and of each other.

    Taken away from the covariances (N, 3, 3) of x, y, yaw, they leave a matrix without negative eigenvalues.
    """
    by_yaw = pose[:, :2, 2]
    place = pose[:, :2, :2] - by_yaw[:, :, None] * by_yaw[:, None] / pose[:, 2, 2, None, None]
    along_box = turn.swapaxes(1, 2) @ place @ turn
    own = np.maximum(np.diagonal(along_box, axis1=1, axis2=2), 1e-12)
    both = np.abs(along_box[:, 0, 1])[:, None]
    return np.asarray(np.maximum(own - both * np.sqrt(own / own[:, ::-1]), 0.0))


def _nearer_ends(boxes: Boxes3D, lidar_xy: F64, turn: F64) -> F64:
    """(N, 2) along length and width: 1 where all lidars are beyond the front or left end, -1 the other, 0 beside.

    Lidars count by the inverse square of their distance, as their points do.
    """
    if not len(lidar_xy):
        return np.zeros((len(boxes), 2))
    gap = lidar_xy - boxes.centers[:, None, :2]
    weights = 1 / np.maximum((gap * gap).sum(2), 1e-3)
    ends = (gap @ turn / (boxes.sizes[:, None, :2] / 2)).clip(-1.0, 1.0)
    return np.asarray((weights[..., None] * ends).sum(1) / weights.sum(1, keepdims=True))
