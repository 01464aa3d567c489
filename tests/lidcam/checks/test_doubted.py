"""Classes of which hardly anything is probable enough."""

from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d
from frames import CONFIG, frame

from lidcam.checks.doubted import DoubtedCheck
from lidcam.pipeline.core.detections import Fused, Hypotheses
from lidcam.pipeline.core.frame import FrameResult

CAR, PEDESTRIAN = 0, 1
BOX = (5.0, 1.0, 0.5, 0.6, 0.6, 1.7, 0.0)


def seen(class_ids: list[int], beliefs: list[float], reported: list[int]) -> FrameResult:
    """A frame of boxes of these classes and probabilities, of which some are reported."""
    boxes, rows = boxes3d([BOX] * len(class_ids), class_ids=class_ids), np.array(reported, np.int64)
    fused = Fused(boxes.select(rows), np.zeros(len(rows), np.int32), rows)
    hypotheses = Hypotheses(boxes, {}, len(boxes))
    return replace(frame(), hypotheses=hypotheses, beliefs=np.array(beliefs, np.float64), fused=fused)


def told(frames: list[FrameResult], *, has_2d_boxes: bool = False) -> list[str]:
    check = DoubtedCheck(CONFIG, has_2d_boxes=has_2d_boxes)
    for one in frames:
        check.add_frame(one)
    return [str(warning) for warning in check.warnings]


def test_what_is_likely_and_hardly_reported_is_told() -> None:
    likely = [seen([CAR, PEDESTRIAN, PEDESTRIAN], [0.9, 0.3, 0.45], [0])] * 10
    (warning,) = told([*likely, seen([PEDESTRIAN], [0.8], [0])])
    assert "pedestrian: 20 boxes have a probability of 0.2 to 0.5, below fuse.min_score; reported: 1" in warning
    assert told(likely, has_2d_boxes=True) == []


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param([], id="no frames"),
        pytest.param([seen([], [], [])], id="nothing"),
        pytest.param([seen([PEDESTRIAN], [0.3], [])] * 4, id="few"),
        pytest.param([seen([PEDESTRIAN], [0.1], [])] * 50, id="improbable"),
        pytest.param([seen([PEDESTRIAN], [0.3], [0])] * 50, id="reported all the same, as part of a track"),
        pytest.param([seen([CAR, CAR], [0.3, 0.9], [1])] * 50, id="a common class"),
    ],
)
def test_nothing_to_tell(frames: list[FrameResult]) -> None:
    assert told(frames) == []
