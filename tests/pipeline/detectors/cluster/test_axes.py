"""Axes of vehicles by those around them."""

import numpy as np
import pytest
from detections import boxes3d

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.detectors.cluster.axes import Axes, axes_of_neighbours


def axes(*vehicles: tuple[float, float, float]) -> Axes:
    """Of cars at x and y with a yaw, of 15 points each."""
    boxes = boxes3d([(x, y, 0.75, 4.2, 1.75, 1.5, yaw) for x, y, yaw in vehicles], scores=np.ones(len(vehicles)))
    return axes_of_neighbours(boxes, np.ones(len(boxes), np.bool_))


def off_rad(found: F64, expected: float) -> F64:
    return np.asarray(np.abs(np.angle(np.exp(4j * (found - expected)))) / 4)


def test_without_neighbours_nothing_is_known() -> None:
    assert axes().log_odds.tolist() == []
    assert axes((0, 0, 0.3)).log_odds.tolist() == [-np.inf]
    assert axes((0, 0, 0.3), (0.5, 0, 0.3)).log_odds.tolist() == [-np.inf] * 2  # two boxes of one vehicle
    assert axes((0, 0, 0.3), (500, 0, 0.3)).log_odds.max() < -100


@pytest.mark.parametrize("yaw", [0.3, 0.3 - np.pi, 0.3 + np.pi / 2], ids=["along", "reversed", "across"])
def test_vehicles_around_tell_the_axis(yaw: float) -> None:
    row = [(6.0 * k, 0.0, 0.3) for k in range(5)]
    found = axes((12.0, 6.0, 0.8), *row, (18.0, 6.0, yaw))
    assert off_rad(found.angles_rad, 0.3).max() < 0.12
    assert found.log_odds[0] > 1.0
    assert found.log_odds[0] > axes((12.0, 6.0, 0.8), *row).log_odds[0] > axes((12.0, 6.0, 0.8), *row[:2]).log_odds[0]


def test_vehicles_of_many_axes_tell_none() -> None:
    ring = np.arange(8) * np.pi / 4
    found = axes((0, 0, 0), *zip(12 * np.cos(ring), 12 * np.sin(ring), ring / 2, strict=True))
    assert found.log_odds[0] < 0


def test_people_have_no_axes_and_tell_none() -> None:
    boxes = boxes3d([(6.0 * k, 0, 0.75, 4.2, 1.75, 1.5, 0.3) for k in range(3)], scores=np.ones(3))
    found = axes_of_neighbours(boxes, np.array([True, False, True]))
    alone = axes_of_neighbours(boxes.select(np.array([0, 2])), np.ones(2, np.bool_))
    assert found.log_odds[1] == -np.inf
    np.testing.assert_allclose(found.log_odds[[0, 2]], alone.log_odds)
