import numpy as np
import pytest
from evaluation_frames import rows_at, truth_boxes

from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.evaluation_frame import UNKNOWN
from pipeline.evaluation.ignoring import is_evaluated, is_within

SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))


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
    boxes = truth_boxes(rows_at([(0, 0)]), lidar_points=[points], image_pixels=[pixels])
    assert is_evaluated(boxes, EvaluateConfig()).tolist() == [expected]


def test_limits_of_points_and_pixels_are_settings() -> None:
    boxes = truth_boxes(rows_at([(0, 0)] * 3), lidar_points=[0, 4, 5], image_pixels=[5, 4, 0])
    config = EvaluateConfig(min_lidar_points=5, min_image_pixels=5)
    assert is_evaluated(boxes, config).tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("x_m", "config", "expected"),
    [
        (0.0, EvaluateConfig(), [False, False, True]),
        (0.0, EvaluateConfig(max_range_m=1e-3), [False, False, True]),
        (2.0, EvaluateConfig(max_range_m=1.0), [False, False, False]),
    ],
)
def test_marked_objects_and_those_of_no_class_are_ignored(
    x_m: float, config: EvaluateConfig, expected: list[bool]
) -> None:
    boxes = truth_boxes(rows_at([(x_m, 0)] * 3), is_ignored=[True, False, False], class_ids=[0, UNKNOWN, 1])
    assert is_evaluated(boxes, config).tolist() == expected
