from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d
from frames import frame

from lidcam.pipeline.core.clouds import CombinedCloud, PointCloud
from lidcam.pipeline.core.detections import Boxes3D, Fused
from lidcam.pipeline.tracking.sightings import find_end_points


def cloud(xyz: np.ndarray, time_ns: np.ndarray) -> CombinedCloud:
    n = len(xyz)
    points = PointCloud(
        0, "site", xyz.astype(np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint16), time_ns.astype(np.int32)
    )
    return replace(frame().combined, detection_cloud=points, detection_lidar_index=np.zeros(n, np.uint8))


def fused(boxes: Boxes3D) -> Fused:
    return Fused(boxes, np.zeros(len(boxes), np.int32), np.arange(len(boxes)))


def box(x: float, y: float, yaw: float) -> Boxes3D:
    return boxes3d([[x, y, 0.8, 4.0, 1.8, 1.6, yaw]])


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_ends_are_the_outermost_points_along_the_box(yaw: float) -> None:
    along = np.linspace(-2.1, 1.9, 40)
    xyz = np.column_stack([5 + along * np.cos(yaw), 3 + along * np.sin(yaw), np.full(40, 0.8)])
    ends = find_end_points(fused(box(5, 3, yaw)), cloud(xyz, np.arange(40) * 10**6))[0]
    front = [5 + 1.9 * np.cos(yaw), 3 + 1.9 * np.sin(yaw), 0.039]
    rear = [5 - 2.1 * np.cos(yaw), 3 - 2.1 * np.sin(yaw), 0.0]
    np.testing.assert_allclose(ends, [front, rear], atol=1e-5)


def test_points_of_others_do_not_count() -> None:
    along = np.linspace(-1.0, 1.0, 20)
    xyz = np.column_stack([np.r_[along, 9.0, 0.0, 0.0], np.r_[np.zeros(20), 0.0, 4.0, 0.0], np.r_[np.ones(22), 5.0]])
    ends = find_end_points(fused(box(0, 0, 0)), cloud(xyz, np.zeros(23)))[0]
    np.testing.assert_allclose(ends[:, 0], [1.0, -1.0], atol=1e-6)


def test_points_of_the_next_object_do_not_count() -> None:
    """Cars parked bumper to bumper."""
    row = boxes3d([[x, 0, 0.8, 4.0, 1.8, 1.6, 0.0] for x in (0.0, 4.4, 8.8)])
    along = np.linspace(-2.0, 10.8, 129)
    ends = find_end_points(fused(row), cloud(np.column_stack([along, 0 * along, 0 * along + 1.0]), np.zeros(129)))
    np.testing.assert_allclose(ends[:, :, 0], [[2.2, -2.0], [6.6, 2.2], [10.8, 6.6]], atol=0.11)


@pytest.mark.parametrize("points", [0, 7])
def test_too_few_points_have_no_ends(points: int) -> None:
    ends = find_end_points(fused(box(0, 0, 0)), cloud(np.ones((points, 3)) * 0.5, np.zeros(points)))
    assert ends.shape == (1, 2, 3)
    assert np.isnan(ends).all()
