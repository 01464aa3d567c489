"""The points of a frame above the ground, judged by array operations."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scene import combined, rig

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, Relief
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter

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
