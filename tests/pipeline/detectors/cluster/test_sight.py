"""What is hidden below by something nearer, and what hangs there."""

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.detector import MAX_NEARER_SHARE, MIN_HIDDEN_SHARE, SECTOR_RAD, SECTORS, Sight
from lidcam.pipeline.stages.detect3d import Detect3D

LIDAR = (0.0, 0.0, 1.8)
TRUCK = 3
LORRY: Box = (40.0, 0.0, 1.75, 8.0, 2.5, 3.5, 0.0)
CAR: Box = (15.0, 0.0, 0.8, 4.0, 3.0, 1.6, 0.0)
BOARD: Box = (36.0, 0.0, 2.7, 0.3, 2.5, 1.6, 0.0)
RINGS = (-24.8, 5.0, 96)


def found_near(x_m: float, *scene: Box) -> list[int]:
    """Classes of the boxes within 6 m of a place ahead."""
    boxes = Detect3D(rig(LIDAR), Config())(combined(scan(LIDAR, [*scene], rings=RINGS)))
    return [int(one) for one in boxes.class_ids[np.hypot(boxes.centers[:, 0] - x_m, boxes.centers[:, 1]) < 6]]


def test_a_lorry_behind_a_car_is_found_and_a_board_in_the_air_is_not() -> None:
    points = scan(LIDAR, [CAR, LORRY], rings=RINGS)
    assert points[points[:, 0] > 30, 2].min() > Config().detect3d.cluster.max_bottom_m
    assert found_near(40.0, CAR, LORRY) == [TRUCK]
    assert found_near(40.0, BOARD) == []
    beside: Box = (15.0, 6.0, 0.8, 4.0, 3.0, 1.6, 0.0)
    assert found_near(40.0, BOARD, beside) == []


@pytest.mark.parametrize(
    ("blocker", "hidden"),
    [
        pytest.param([10.0, 0.0, 1.7], True, id="up to the cluster"),
        pytest.param([10.0, 3.0, 1.7], False, id="beside"),
        pytest.param([10.0, 0.0, 1.0], False, id="too low"),
        pytest.param([10.0, 0.0, 1.9], False, id="in front of the cluster itself"),
        pytest.param([30.0, 0.0, 1.2], False, id="behind"),
    ],
)
def test_by_hand(blocker: list[float], hidden: bool) -> None:
    """A lidar 1.8 m up looks at a cluster that begins at 1.6 m, 20 m ahead."""
    cluster = np.array([[20.0, 0.0, 1.6], [20.0, 0.1, 2.4]])
    origins, points = np.array([[0.0, 0.0, 1.8]]), np.array([*cluster, blocker])
    lidar = np.zeros(3, np.int64)
    sight = Sight.of(points, lidar, origins)
    assert sight.is_hidden_below(cluster, lidar[:2], np.array([0]), 1.0).tolist() == [hidden]


def test_another_lidar_does_not_hide_and_no_clusters_are_fine() -> None:
    cluster = np.array([[20.0, 0.0, 1.6], [20.0, 0.1, 2.4]])
    origins = np.array([[0.0, 0.0, 1.8], [0.0, 0.5, 1.8]])
    sight = Sight.of(np.array([*cluster, [10.0, 0.0, 1.7]]), np.array([0, 0, 1]), origins)
    assert sight.is_hidden_below(cluster, np.zeros(2, np.int64), np.array([0]), 1.0).tolist() == [False]
    none = np.zeros(0, np.int64)
    assert not len(sight.is_hidden_below(cluster[:0], none, none, 1.0))
    assert not len(Sight.of(cluster[:0], none, origins).slope)


def judged(sight: Sight, position: F64, lidar: I64, cluster: I64, from_m: float) -> list[bool]:
    """What `is_hidden_below` says of each cluster, by all its points with all points of the frame."""
    found = []
    gap = position - sight.origins[lidar]
    sector = lidar * SECTORS + ((np.arctan2(gap[:, 1], gap[:, 0]) + np.pi) / SECTOR_RAD).astype(np.int64)
    far_m = np.hypot(gap[:, 0], gap[:, 1])
    of_point = np.repeat(np.arange(len(sight.starts) - 1), np.diff(sight.starts))
    for one in np.unique(cluster):
        rows = np.flatnonzero(cluster == one)
        _, first = np.unique(sector[rows], return_index=True)
        rows, bottom_m = rows[first], position[rows, 2].min()
        meets_m = sight.origins[lidar[rows], 2][:, None] + far_m[rows][:, None] * sight.slope
        hides = (of_point == sector[rows][:, None]) & (sight.distance_m < MAX_NEARER_SHARE * far_m[rows][:, None])
        hides &= (meets_m >= from_m / 2) & (meets_m <= bottom_m)
        found.append(bool(hides.any(1).mean() >= MIN_HIDDEN_SHARE))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_same_as_by_array_operations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, lidar = rng.uniform([-20, -20, 0], [20, 20, 3], (3000, 3)), rng.integers(0, 2, 3000)
    sight = Sight.of(points, lidar, np.array([[0.0, 0.0, 1.8], [1.0, 0.5, 2.5]]))
    cluster = np.repeat(np.arange(60), rng.integers(1, 30, 60))
    middle = rng.uniform([-25, -25, 1.2], [25, 25, 3], (60, 3))
    position, own = middle[cluster] + rng.uniform(0, 1, (len(cluster), 3)), rng.integers(0, 2, len(cluster))
    starts = np.searchsorted(cluster, np.arange(60))
    hidden = sight.is_hidden_below(position, own, starts, 1.0).tolist()
    assert hidden == judged(sight, position, own, cluster, 1.0)
    assert {*hidden} == {True, False}
