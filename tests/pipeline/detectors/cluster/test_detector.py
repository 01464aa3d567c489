"""The points of a frame above the ground, judged by array operations."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, Relief
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.detector import SECTOR_RAD, Sight
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.stages.detect3d import Detect3D

LIDARS = np.array([[0.0, 0.0, 1.8], [3.0, -1.0, 2.0]])
SLOPE = Plane(np.array([-0.1, 0.02, 1.0]) / np.sqrt(1.0104), 0.2)
HILLS = Relief(np.array([-10.0, -20.0]), 2.5, np.random.default_rng(3).normal(0, 0.2, (9, 7)))


def cloud(plane: Plane | None, relief: Relief | None) -> CombinedCloud:
    """Points on and beyond the relief's grid, by two lidars."""
    points: F64 = np.random.default_rng(0).uniform([-20, -30, -3], [20, 30, 5], (2000, 3))
    return replace(
        combined(points, plane=plane), relief=relief, detection_lidar_index=np.arange(2000).astype(np.uint8) % 2
    )


@pytest.mark.parametrize(("plane", "relief"), [(None, None), (SLOPE, None), (SLOPE, HILLS), (None, HILLS)])
@pytest.mark.parametrize("heights_m", [(0.3, 2.0), (-np.inf, np.inf), (1.0, 1.0)])
def test_points_above_ground(plane: Plane | None, relief: Relief | None, heights_m: tuple[float, float]) -> None:
    frame, rows = cloud(plane, relief), np.random.default_rng(1).permutation(2000)[:1500]
    points, lidars = frame.detection_cloud, frame.detection_lidar_index
    times = points.time_offset_ns
    settings = ClusterConfig(distance_m=0.4, distance_per_m=0.01)
    fitter = BoxFitter(replace(rig(*map(tuple, LIDARS)), ground_height_m=0.25), Config().classes, settings)
    place, position, lidar, link_m, time_ns = fitter.above_ground(frame, rows, *heights_m)
    xyz = points.xyz[rows].astype(np.float64)
    height = xyz[:, 2] - frame.ground_m(xyz[:, :2], level_m=0.25)
    np.testing.assert_array_equal(place, np.flatnonzero((height > heights_m[0]) & (height < heights_m[1])))
    np.testing.assert_array_equal(position[:, :2], xyz[place, :2])
    np.testing.assert_allclose(position[:, 2], height[place], rtol=0, atol=1e-14)  # the plane's sum may be fused there
    np.testing.assert_array_equal(lidar, lidars[rows[place]])
    np.testing.assert_array_equal(time_ns, times[rows[place]])
    range_m = np.sqrt(((xyz[place] - LIDARS[lidar]) ** 2).sum(1))
    np.testing.assert_array_equal(link_m, 0.4 + 0.01 * range_m)


# --- what is hidden below by something nearer, and what hangs there


LIDAR = (0.0, 0.0, 1.8)
TRUCK = 3
LORRY: Box = (40.0, 0.0, 1.75, 8.0, 2.5, 3.5, 0.0)
CAR: Box = (15.0, 0.0, 0.8, 4.0, 3.0, 1.6, 0.0)
BOARD: Box = (36.0, 0.0, 2.7, 0.3, 2.5, 1.6, 0.0)
RINGS = (-24.8, 5.0, 96)


def found_ahead(*scene: Box) -> list[int]:
    """Classes of the boxes within 6 m of a place 40 m ahead."""
    boxes = Detect3D(rig(LIDAR), Config())(combined(scan(LIDAR, [*scene], rings=RINGS)))
    return [int(one) for one in boxes.class_ids[np.hypot(boxes.centers[:, 0] - 40.0, boxes.centers[:, 1]) < 6]]


def test_a_lorry_behind_a_car_is_found_and_a_board_in_the_air_is_not() -> None:
    points = scan(LIDAR, [CAR, LORRY], rings=RINGS)
    assert points[points[:, 0] > 30, 2].min() > Config().detect3d.cluster.max_bottom_m
    assert found_ahead(CAR, LORRY) == [TRUCK]
    assert found_ahead(BOARD) == []
    beside: Box = (15.0, 6.0, 0.8, 4.0, 3.0, 1.6, 0.0)
    assert found_ahead(BOARD, beside) == []


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
    """A lidar 1.8 m up looks at a cluster that begins at 1.6 m, 20 m ahead, and at others to its left and behind it."""
    cluster = np.array([[20.0, 0.0, 1.6], [20.0, 0.1, 2.4]])
    clusters = np.concatenate([[[0.0, 20.0, 1.6]], cluster, -cluster * [1, 1, -1]])
    origins, points = np.array([[0.0, 0.0, 1.8]]), np.array([*clusters, blocker, blocker])
    lidar = np.zeros(len(points), np.int64)
    sight = Sight.of(points, lidar, origins)
    assert sight.is_hidden_below(clusters, lidar[:5], np.array([0, 1, 3]), 1.0).tolist() == [False, hidden, False]


@pytest.mark.parametrize(("count", "hidden"), [(1, False), (2, True)])
def test_half_of_the_sectors_have_to_be_hidden(count: int, hidden: bool) -> None:
    azimuth = SECTOR_RAD * (np.arange(4) + 0.5)
    ahead = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(4)])
    cluster, nearer = 20 * ahead + [0, 0, 1.6], 10 * ahead[:count] + [0, 0, 1.7]
    lidar = np.zeros(4 + count, np.int64)
    sight = Sight.of(np.concatenate([cluster, nearer]), lidar, np.array([[0.0, 0.0, 1.8]]))
    assert sight.is_hidden_below(cluster, lidar[:4], np.array([0]), 1.0).tolist() == [hidden]


def test_another_lidar_does_not_hide_and_no_clusters_are_fine() -> None:
    cluster = np.array([[20.0, 0.0, 1.6], [20.0, 0.1, 2.4]])
    origins = np.array([[0.0, 0.0, 1.8], [0.0, 0.5, 1.8]])
    sight = Sight.of(np.array([*cluster, [10.0, 0.0, 1.7]]), np.array([0, 0, 1]), origins)
    assert sight.is_hidden_below(cluster, np.zeros(2, np.int64), np.array([0]), 1.0).tolist() == [False]
    none = np.zeros(0, np.int64)
    assert not len(sight.is_hidden_below(cluster[:0], none, none, 1.0))
    assert not len(Sight.of(cluster[:0], none, origins).slope)
