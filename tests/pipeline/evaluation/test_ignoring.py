from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.ignoring import is_evaluated, is_within
from pipeline.evaluation.records import UNKNOWN, TruthBoxes3D

SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))


def truth(count: int) -> TruthBoxes3D:
    return TruthBoxes3D(
        0,
        "site",
        np.zeros((count, 3)),
        np.ones((count, 3)),
        np.zeros(count),
        np.zeros(count, np.int32),
        np.array(["car"] * count, np.str_),
        np.arange(count, dtype=np.int64),
        np.full(count, UNKNOWN, np.int32),
        np.full(count, UNKNOWN, np.int32),
        np.zeros(count, np.bool_),
    )


@pytest.mark.parametrize(
    ("region", "max_range_m", "expected"),
    [
        (None, None, [True, True, True, True]),
        (SQUARE, None, [True, True, False, False]),
        (None, 5.0, [True, False, True, False]),
        (SQUARE, 5.0, [True, False, False, False]),
    ],
)
def test_what_lies_outside_is_not_within(
    region: tuple[tuple[float, float], ...] | None, max_range_m: float | None, expected: list[bool]
) -> None:
    config = EvaluateConfig(region=region, max_range_m=max_range_m)
    centers = np.array([[3.0, 4.0, 99.0], [10, 10, 0], [-3, -4, 0], [11, 0, 0]])
    assert is_within(centers, config).tolist() == expected
    assert is_within(centers[:0], config).tolist() == []


@pytest.mark.parametrize(
    ("points", "pixels", "expected"),
    [
        (0, 0, False),
        (1, 0, True),
        (0, 1, True),
        (UNKNOWN, 0, False),
        (0, UNKNOWN, False),
        (UNKNOWN, UNKNOWN, True),
    ],
)
def test_objects_that_no_sensor_saw_are_ignored(points: int, pixels: int, expected: bool) -> None:
    boxes = replace(truth(1), lidar_points=np.array([points], np.int32), image_pixels=np.array([pixels], np.int32))
    assert is_evaluated(boxes, EvaluateConfig()).tolist() == [expected]


def test_limits_of_points_and_pixels_are_settings() -> None:
    counts = np.array([0, 4, 5], np.int32)
    boxes = replace(truth(3), lidar_points=counts, image_pixels=counts[::-1].copy())
    config = EvaluateConfig(min_lidar_points=5, min_image_pixels=5)
    assert is_evaluated(boxes, config).tolist() == [True, False, True]


def test_marked_objects_and_those_of_no_class_are_ignored() -> None:
    boxes = replace(truth(3), is_ignored=np.array([True, False, False]), class_ids=np.array([0, UNKNOWN, 1], np.int32))
    assert is_evaluated(boxes, EvaluateConfig()).tolist() == [False, False, True]
    assert is_evaluated(boxes, EvaluateConfig(max_range_m=1e-3)).tolist() == [False, False, True]
    far = replace(boxes, centers=np.full((3, 3), 2.0))
    assert not is_evaluated(far, EvaluateConfig(max_range_m=1.0)).any()
