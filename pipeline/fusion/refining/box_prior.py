"""What is known of a box before the images are asked: means and covariances of its place, heading, size and speed."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F64, check_array
from pipeline.core.detections import Boxes3D, Source
from pipeline.core.geometry.boxes import rotations_2d
from pipeline.core.settings.fuse import FuseConfig
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


@dataclass(frozen=True, slots=True, eq=False)
class BoxPrior:
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

    def __post_init__(self) -> None:
        n = len(self.covariances)
        check_array("covariances", self.covariances, (n, 7, 7), np.float64)
        check_array("information", self.information, (n, 7, 7), np.float64)
        check_array("yaw_shares", self.yaw_shares, (n,), np.float64)
        check_array("yaw_rests", self.yaw_rests, (n,), np.float64)


def known_covariances(boxes: Boxes3D, lidar_xy: F64) -> F64:
    """(N, 3, 3) covariances of x, y (m^2) and yaw (rad^2); a guess by size and distance where they are unknown.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres; there may be none.
    """
    length, width = boxes.sizes[:, :2].max(1), boxes.sizes[:, :2].min(1)
    away = np.linalg.norm(boxes.centers[:, None, :2] - lidar_xy, axis=2).min(1, initial=np.inf)
    place = UNKNOWN_SHARE * width + UNKNOWN_PER_M * np.where(np.isfinite(away), away, 0.0)
    shows = np.clip((length / width - 1) / (SQUARE - 1), 0.0, 1.0)
    yaw = ANY_YAW_RAD + shows * (UNKNOWN_YAW_RAD - ANY_YAW_RAD)
    guess = np.stack([place, place, yaw], 1)[:, None] ** 2 * np.eye(3)
    known = np.any(boxes.covariances, axis=(1, 2), keepdims=True)
    return np.where(known, boxes.covariances, guess)


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
    n, extent = len(boxes), boxes.sizes[:, :2]
    turn = rotations_2d(boxes.yaws)
    given = known_covariances(boxes, lidar_xy) * config.lidar_sigma_scale**2
    least = LEAST_SHARE * extent.min(1)
    covariances = np.zeros((n, 7, 7))
    covariances[:, :3, :3] = given
    covariances[:, 2, 2] = np.clip(given[:, 2, 2], LEAST_RAD**2, MOST_YAW_RAD**2)
    shrunk = np.sqrt(covariances[:, 2, 2] / np.maximum(given[:, 2, 2], 1e-12))
    covariances[:, :2, 2] *= shrunk[:, None]
    covariances[:, 2, :2] *= shrunk[:, None]
    covariances[:, [0, 1], [0, 1]] += least[:, None] ** 2

    # A side that no lidar saw makes the variances along length and width differ: the difference comes from the size.
    left = _along_and_across(covariances[:, :3, :3], turn)
    anchor = _nearer_end(boxes, turn, lidar_xy) / 2
    grown = np.minimum(left - left.min(1, keepdims=True), MOST_EXPLAINED * left)
    size = np.minimum(config.size_sigma**2, grown / np.maximum(np.abs(anchor), LEAST_ANCHOR) ** 2 / extent**2)
    least_size = np.where(boxes.sources == Source.CAMERA, CLASS_SHARE, SEEN_SHARE)[:, None] ** 2
    size = np.maximum(np.maximum(size, np.minimum(least_size, config.size_sigma**2)), 1e-6) * extent**2
    size = np.minimum(size, np.maximum(MOST_EXPLAINED * left / np.maximum(anchor**2, 1e-9), 1e-6 * extent**2))
    too_wide = np.where(np.abs(anchor) > LEAST_ANCHOR, np.maximum(grown - anchor**2 * size, 0.0), 0.0)
    covariances[:, :2, :2] -= np.einsum("nij,nj,nkj->nik", turn, too_wide, turn)
    covariances[:, [3, 4], [3, 4]] = size
    shift = -np.einsum("nij,nj->nij", turn, anchor * size)  # (N, xy, length and width)
    covariances[:, :2, 3:5] = shift
    covariances[:, 3:5, :2] = shift.transpose(0, 2, 1)

    speed = SPEED_PER_S * np.sqrt(extent.prod(1))
    covariances[:, 5, 5] = speed**2
    covariances[:, 6, 6] = (speed * extent.min(1) / extent.max(1)) ** 2
    own = covariances[:, 2, 2].copy()
    covariances[:, 2, 2] += np.deg2rad(config.heading_sigma_deg) ** 2
    shares = own / covariances[:, 2, 2]
    return BoxPrior(covariances, inverse(covariances), shares, own * (1 - shares))


def _along_and_across(covariances: F64, turn: F64) -> F64:
    """(N, 2) variances of the centre along length and width that are independent of the yaw and of each other.

    Taken away from covariances (N, 3, 3) of x, y, yaw, they leave matrices without negative eigenvalues.
    """
    by_yaw = covariances[:, :2, 2]
    place = covariances[:, :2, :2] - by_yaw[:, :, None] * by_yaw[:, None] / covariances[:, 2, 2, None, None]
    place = np.einsum("nji,njk,nkl->nil", turn, place, turn)
    own = np.maximum(place[:, [0, 1], [0, 1]], 1e-12)
    free: F64 = np.maximum(own - np.abs(place[:, :1, 1]) * np.sqrt(own / own[:, ::-1]), 0.0)
    return free


def _nearer_end(boxes: Boxes3D, turn: F64, lidar_xy: F64) -> F64:
    """(N, 2) along length and width: 1 where all lidars are beyond the front or left end, -1 the other, 0 beside.

    Lidars count by the inverse square of their distance, as their points do. Boxes without points have no such end.
    """
    if not len(lidar_xy):
        return np.zeros((len(boxes), 2))
    apart = lidar_xy - boxes.centers[:, None, :2]  # (N, L, 2)
    towards = np.einsum("nlj,nji->nli", apart, turn)
    ends = np.clip(towards / (boxes.sizes[:, None, :2] / 2), -1.0, 1.0)
    weights = 1 / np.maximum((apart**2).sum(2), 1e-3)
    seen = (boxes.sources != Source.CAMERA)[:, None]
    return np.where(seen, np.einsum("nl,nli->ni", weights / weights.sum(1, keepdims=True), ends), 0.0)
