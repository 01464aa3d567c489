"""What is known of a box before the images are asked: means and covariances of its place, heading, size and speed."""

from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D, Source
from pipeline.core.settings.fuse import FuseConfig
from pipeline.fusion.refining.prior_kernels import guessed_covariances, prior_covariances
from pipeline.fusion.small_matrices import inverse

__all__ = ["STATES", "BoxPrior", "box_prior", "known_covariances"]

STATES = ("x", "y", "yaw", "length", "width", "speed along", "speed across")
"""Order of the state: metres, radians, metres per second along the axes of the box."""

UNKNOWN_SHARE, UNKNOWN_PER_M = 0.1, 0.005
"""Standard deviation of a place without covariance: a share of the box's width, and of the distance from the lidars."""

UNKNOWN_YAW_RAD, ANY_YAW_RAD = 0.1, np.pi / 4
"""Standard deviation of a heading without covariance, where length and width differ much, and where they are equal."""

SQUARE = 1.5
"""Length by width from which on the heading of a box shows."""

LEAST_SHARE, LEAST_RAD = 0.01, np.deg2rad(0.5)
"""Smallest standard deviations, of the place as a share of the width: boxes are not known better."""

MOST_YAW_RAD = 0.6
"""Largest standard deviation of a heading that is refined; front and rear are not told apart here."""

SEEN_SHARE = 0.03
"""Standard deviation of a length, and a width, of which lidars saw both ends, as a share of it."""

MOST_EXPLAINED = 0.95
"""Largest share of the variance of the centre that comes from an unknown length, or width."""

LEAST_ANCHOR = 0.25
"""Where lidars see both ends, the length errs by four times the error of the centre at most."""

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
    guess = np.array([UNKNOWN_SHARE, UNKNOWN_PER_M, UNKNOWN_YAW_RAD, ANY_YAW_RAD, SQUARE])
    return guessed_covariances(boxes.covariances, boxes.centers, boxes.sizes, lidar_xy, guess)


def box_prior(boxes: Boxes3D, lidar_xy: F64, config: FuseConfig) -> BoxPrior:
    """The distributions of boxes.

    A box whose far side no lidar saw has the length of its class, and grows away from the lidars: if it is longer, its
    centre is farther away. So length and centre are correlated as far as the lidars are beyond one end of the box. If
    the covariance allows for more than `size_sigma` does, it is the smaller one that holds.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres.
        config: `lidar_sigma_scale`, `size_sigma` and `heading_sigma_deg`.
    """
    limits = [LEAST_SHARE, LEAST_RAD**2, MOST_YAW_RAD**2, MOST_EXPLAINED, LEAST_ANCHOR, config.size_sigma**2]
    limits += [SEEN_SHARE**2, CLASS_SHARE**2, SPEED_PER_S, np.deg2rad(config.heading_sigma_deg) ** 2]
    covariances, yaw_shares, yaw_rests = prior_covariances(
        known_covariances(boxes, lidar_xy) * config.lidar_sigma_scale**2,
        boxes.centers,
        boxes.sizes,
        np.cos(boxes.yaws),
        np.sin(boxes.yaws),
        boxes.sources != Source.CAMERA.value,
        lidar_xy,
        np.array(limits),
    )
    return BoxPrior(covariances, inverse(covariances), yaw_shares, yaw_rests)
