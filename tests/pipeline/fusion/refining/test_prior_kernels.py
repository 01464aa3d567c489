"""What is known of boxes before the images, in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.refining.prior_kernels import guessed_covariances, prior_covariances

from pipeline.core.arrays import F64, Bools
from pipeline.core.geometry.boxes import rotations_2d

LIMITS = np.array([0.01, 0.0087**2, 0.6**2, 0.95, 0.25, 0.15**2, 0.03**2, 0.1**2, 2.5, 0.05**2])
GUESS = np.array([0.1, 0.005, 0.1, np.pi / 4, 1.5])


def judged(given: F64, centers: F64, sizes: F64, yaws: F64, is_seen: Bools, lidar_xy: F64) -> tuple[F64, F64, F64]:
    """As `prior_covariances`."""
    (
        least_share,
        least_yaw,
        most_yaw,
        explained,
        least_anchor,
        most_size,
        seen_size,
        class_size,
        speed_per_s,
        heading,
    ) = LIMITS.tolist()
    extent, turn = sizes[:, :2], rotations_2d(yaws)
    C = np.zeros((len(sizes), 7, 7))
    C[:, :3, :3] = given
    C[:, 2, 2] = np.clip(given[:, 2, 2], least_yaw, most_yaw)
    shrunk = np.sqrt(C[:, 2, 2] / np.maximum(given[:, 2, 2], 1e-12))[:, None]
    C[:, :2, 2] *= shrunk
    C[:, 2, :2] *= shrunk
    C[:, [0, 1], [0, 1]] += (least_share * extent.min(1))[:, None] ** 2

    by_yaw = C[:, :2, 2]
    place = C[:, :2, :2] - by_yaw[:, :, None] * by_yaw[:, None] / C[:, 2, 2, None, None]
    place = np.einsum("nji,njk,nkl->nil", turn, place, turn)
    own = np.maximum(place[:, [0, 1], [0, 1]], 1e-12)
    left = np.maximum(own - np.abs(place[:, :1, 1]) * np.sqrt(own / own[:, ::-1]), 0.0)

    apart = lidar_xy - centers[:, None, :2]
    ends = np.clip(np.einsum("nlj,nji->nli", apart, turn) / (extent[:, None] / 2), -1.0, 1.0)
    weights = 1 / np.maximum((apart**2).sum(2), 1e-3)
    nearer = np.einsum("nl,nli->ni", weights / np.maximum(weights.sum(1, keepdims=True), 1e-300), ends)
    anchor = np.where(is_seen[:, None], nearer, 0.0) / 2

    grown = np.minimum(left - left.min(1, keepdims=True), explained * left)
    size = np.minimum(most_size, grown / np.maximum(np.abs(anchor), least_anchor) ** 2 / extent**2)
    least_size = np.minimum(np.where(is_seen, seen_size, class_size)[:, None], most_size)
    size = np.maximum(np.maximum(size, least_size), 1e-6) * extent**2
    size = np.minimum(size, np.maximum(explained * left / np.maximum(anchor**2, 1e-9), 1e-6 * extent**2))
    too_wide = np.where(np.abs(anchor) > least_anchor, np.maximum(grown - anchor**2 * size, 0.0), 0.0)
    C[:, :2, :2] -= np.einsum("nij,nj,nkj->nik", turn, too_wide, turn)
    C[:, [3, 4], [3, 4]] = size
    C[:, :2, 3:5] = -turn * (anchor * size)[:, None]
    C[:, 3:5, :2] = C[:, :2, 3:5].transpose(0, 2, 1)

    speed = speed_per_s * np.sqrt(extent.prod(1))
    C[:, 5, 5], C[:, 6, 6] = speed**2, (speed * extent.min(1) / extent.max(1)) ** 2
    own_yaw = C[:, 2, 2].copy()
    C[:, 2, 2] += heading
    return C, own_yaw / C[:, 2, 2], own_yaw * (1 - own_yaw / C[:, 2, 2])


@pytest.mark.parametrize(("count", "lidars"), [(0, 2), (1, 1), (60, 3), (20, 0)])
def test_priors(count: int, lidars: int) -> None:
    random = np.random.default_rng(count)
    root = random.normal(size=(count, 3, 3)) * random.uniform(0.02, 1, (count, 3, 1))
    centers, sizes = random.uniform(-15, 15, (count, 3)), random.uniform(0.4, 9, (count, 3))
    yaws, is_seen = random.uniform(-3, 3, count), random.random(count) < 0.7
    lidar_xy = random.normal(0, 5, (lidars, 2))
    known = root @ root.transpose(0, 2, 1)
    found = prior_covariances(known, centers, sizes, np.cos(yaws), np.sin(yaws), is_seen, lidar_xy, LIMITS)
    for one, other in zip(found, judged(known, centers, sizes, yaws, is_seen, lidar_xy), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lidars", [0, 1, 3])
def test_guesses(lidars: int) -> None:
    random = np.random.default_rng(lidars)
    centers, sizes = random.uniform(-30, 30, (20, 3)), random.uniform(0.4, 9, (20, 3))
    lidar_xy = random.normal(0, 5, (lidars, 2))
    given = np.where((np.arange(20) % 2 == 0)[:, None, None], 0.0, random.normal(size=(20, 3, 3)))
    found = guessed_covariances(given, centers, sizes, lidar_xy, GUESS)
    np.testing.assert_array_equal(found[1::2], given[1::2])
    length, width = sizes[:, :2].max(1), sizes[:, :2].min(1)
    away = np.linalg.norm(centers[:, None, :2] - lidar_xy, axis=2).min(1) if lidars else np.zeros(20)
    place, shows = GUESS[0] * width + GUESS[1] * away, np.clip((length / width - 1) / 0.5, 0, 1)
    yaw = GUESS[3] + shows * (GUESS[2] - GUESS[3])
    expected = np.stack([place, place, yaw], 1)[:, None] ** 2 * np.eye(3)
    np.testing.assert_allclose(found[::2], expected[::2], rtol=1e-12)
