import numpy as np
import pytest
from detections import boxes2d, boxes3d

from pipeline.core.detections import Boxes2D, Hypotheses, Matches
from pipeline.core.settings.config import Config
from pipeline.stages.classify import Classify

CAR, PEDESTRIAN, BICYCLE = 0, 1, 2
PLACE = (5.0, 1.0, 0.5, 4.0, 1.8, 1.5, 0.3)


def matches(*pairs: tuple[int, int], boxes: int) -> Matches:
    return Matches(
        np.array(pairs, np.int64).reshape(-1, 2),
        np.full(len(pairs), 0.8, np.float32),
        np.zeros((boxes, 4), np.float32),
        np.zeros(boxes, np.float32),
    )


def seen(score: float, class_id: int) -> Boxes2D:
    return boxes2d([(0, 0, 10, 10, score, class_id)])


@pytest.mark.parametrize(
    ("own", "cameras", "class_id"),
    [
        (CAR, [], CAR),
        (CAR, [(0.8, CAR)], CAR),
        (CAR, [(0.8, PEDESTRIAN)], PEDESTRIAN),
        (PEDESTRIAN, [(0.5, CAR), (0.5, PEDESTRIAN)], PEDESTRIAN),
    ],
)
def test_class(own: int, cameras: list[tuple[float, int]], class_id: int) -> None:
    boxes = boxes3d([PLACE], scores=[0.5], class_ids=[own])
    found = {f"cam{i}": seen(*camera) for i, camera in enumerate(cameras)}
    given = Hypotheses(boxes, {name: matches((0, 0), boxes=1) for name in found}, 1)
    told = Classify(Config())(given, found)
    assert told.boxes.class_ids.tolist() == [class_id]
    np.testing.assert_array_equal(told.boxes.scores, boxes.scores)
    assert boxes.class_ids.tolist() == [own], "the input is left as it was"
