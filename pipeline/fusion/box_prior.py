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

EXPLAINED = 0.45
"""Share of the variance of the centre that an unknown length may explain, and an unknown width."""

SPEED_PER_S = 2.5
"""Standard deviation of the speed along the box, in geometric means of its length and width per second: 6.5 m/s for a
car, 1.5 m/s for a pedestrian, and as much less in a model."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxPrior:
    """Independent normal distributions of N boxes over `STATES`.

    Attributes:
        covariances: (N, 7, 7) float64.
        information: (N, 7, 7) float64, their inverses.
    """

    covariances: F64
    information: F64

    def __post_init__(self) -> None:
        n = len(self.covariances)
        check_array("covariances", self.covariances, (n, 7, 7), np.float64)
        check_array("information", self.information, (n, 7, 7), np.float64)


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
    centre is farther away. So length and centre are correlated as far as the lidars are beyond one end of the box.

    Args:
        boxes: N boxes.
        lidar_xy: (L, 2) positions of the lidars, metres.
        config: `lidar_sigma_scale` and `size_sigma`.
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

    # What is left of the variance along length and width once all else is known bounds what the size may explain.
    left = 1 / np.einsum("nji,njk,nki->ni", turn, inverse(covariances[:, :3, :3])[:, :2, :2], turn)
    anchor = _nearer_end(boxes, turn, lidar_xy) / 2
    size = np.minimum((config.size_sigma * extent) ** 2, EXPLAINED * left / np.maximum(anchor**2, 1e-6))
    covariances[:, [3, 4], [3, 4]] = np.maximum(size, (1e-3 * extent) ** 2)
    shift = -np.einsum("nij,nj->nij", turn, anchor * size)  # (N, xy, length and width)
    covariances[:, :2, 3:5] = shift
    covariances[:, 3:5, :2] = shift.transpose(0, 2, 1)

    speed = SPEED_PER_S * np.sqrt(extent.prod(1))
    covariances[:, 5, 5] = speed**2
    covariances[:, 6, 6] = (speed * extent.min(1) / extent.max(1)) ** 2
    return BoxPrior(covariances, inverse(covariances))


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
