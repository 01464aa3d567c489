"""How well a fitted box is known."""

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.protocols import Candidates3D

LIDAR = (0.0, 0.0, 1.8)
CAR, PEDESTRIAN, BICYCLE = range(3)


def fitted(box: Box, class_id: int, *, noise_m: float = 0.01) -> Candidates3D:
    cloud = combined(scan(LIDAR, [box], noise_m=noise_m))
    rows = np.arange(len(cloud.detection_cloud))
    return BoxFitter(rig(LIDAR), Config().classes, Config().detect3d.cluster)(
        cloud, rows, np.array([0]), np.array([class_id])
    )


def stds(boxes: Candidates3D) -> F64:
    """Of the centre along and across, and of yaw (degrees)."""
    turn = np.array([[np.cos(boxes.yaws[0]), np.sin(boxes.yaws[0])], [-np.sin(boxes.yaws[0]), np.cos(boxes.yaws[0])]])
    own = turn @ boxes.covariances[0, :2, :2] @ turn.T
    assert own[0, 1] == pytest.approx(0, abs=1e-12)
    return np.array([*np.sqrt(np.diag(own)), np.rad2deg(np.sqrt(boxes.covariances[0, 2, 2]))])


def test_a_seen_side_is_known_and_a_grown_one_is_not() -> None:
    rear, side = (stds(fitted((x, y, 0.75, 4.0, 1.7, 1.5, 0.0), CAR)) for x, y in ((12, 0), (0, 8)))
    assert rear[0] > 3 * rear[1]
    assert side[0] < rear[0]
    assert rear[2] < 10
    assert side[2] < 5


def test_headings_of_people_are_not_known_and_those_of_riders_roughly() -> None:
    """Shoulders do not show where a rider is heading."""
    rider, blunt = (stds(fitted((8.0, 0.0, 0.9, *size, 1.7, 1.2), BICYCLE))[2] for size in ((1.7, 0.5), (1.0, 0.7)))
    assert 2 < rider < 5 < blunt
    walker, shoulders = (8.0, 0.0, 0.9, 0.5, 0.5, 1.8, 0.0), (8.0, 0.0, 1.2, 0.25, 0.5, 1.0, 0.6)
    for box, class_id in ((walker, PEDESTRIAN), (shoulders, BICYCLE)):
        assert stds(fitted(box, class_id))[2] == pytest.approx(180 / np.sqrt(12))


def test_rough_objects_are_known_less() -> None:
    car = (8.0, 0.0, 0.75, 4.0, 1.7, 1.5, 0.0)
    assert (stds(fitted(car, CAR, noise_m=0.1))[1:] > stds(fitted(car, CAR))[1:]).all()


def test_errors_of_cars_all_around_are_as_large_as_said() -> None:
    rng = np.random.default_rng(4)
    squares = []
    for bearing in np.linspace(-3, 3, 12):
        range_m, yaw = rng.uniform(6, 25), rng.uniform(-3, 3)
        size = np.array([4.1, 1.75, 1.5]) + rng.normal(0, [0.35, 0.08, 0.05])
        x, y = range_m * np.cos(bearing), range_m * np.sin(bearing)
        boxes = fitted((x, y, size[2] / 2, size[0], size[1], size[2], yaw), CAR, noise_m=0.02)
        turn = (boxes.yaws[0] - yaw + np.pi / 2) % np.pi - np.pi / 2
        error = np.array([boxes.centers[0, 0] - x, boxes.centers[0, 1] - y, turn])
        squares.append(error @ np.linalg.solve(boxes.covariances[0], error))
    assert 0.3 < np.median(squares) < 4  # 2.4 of three normal errors
    assert np.mean(squares) < 6
