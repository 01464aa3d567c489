from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evaluation_frames import frame_of, image, rows_at, source_boxes, truth2d, truth_boxes

from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.detection.detection_evaluation import DetectionEvaluation
from lidcam.pipeline.evaluation.tracking.tracking_evaluation import TrackingEvaluation

CAR, TRUCK, BUS = 0, 3, 4


@pytest.mark.parametrize(
    ("found", "car", "truck"),
    [
        pytest.param([CAR], (1, 1, 0), (0, 0, 0), id="as a car"),
        pytest.param([TRUCK], (0, 0, 0), (1, 1, 0), id="as a truck"),
        pytest.param([TRUCK, CAR], (0, 0, 1), (1, 1, 0), id="the higher score counts"),
        pytest.param([], (0, 0, 0), (1, 0, 0), id="missed"),
        pytest.param([BUS], (0, 0, 0), (1, 0, 0), id="as a bus"),
    ],
)
def test_a_van_counts_for_the_class_that_it_is_found_as(
    found: list[int], car: tuple[int, int, int], truck: tuple[int, int, int]
) -> None:
    """True objects, right and false boxes; in 3D, in an image, and as tracks."""
    n, scores = len(found), [0.9, 0.8][: len(found)]
    here = rows_at([(10, 0)])
    boxes = source_boxes(here * n + rows_at([(90, 0)]), range(n + 1), scores=[*scores, 0.1], class_ids=[*found, BUS])
    true2d = replace(truth2d([0, 0, 9, 9], [TRUCK]), labels=np.array(["van"]))
    shown = image([[0, 0, 9, 9]] * n, scores, found, true2d)
    true = truth_boxes(here, [5], class_ids=[TRUCK], labels=["Van"])
    detection, tracking = DetectionEvaluation(Config(), ()), TrackingEvaluation(Config())
    for evaluation in (detection, tracking):
        for index in range(2):
            evaluation.add_frame(frame_of(index, true, {"fused": boxes}, {"eye": shown}))
    figures: Any = {**detection.figures(), **tracking.figures()}
    for tree in (figures["sources"]["fused"], figures["images"]["eye"]):
        counts = [[tree[name][key] for key in ("truth", "right", "false")] for name in ("car", "truck")]
        np.testing.assert_array_equal(counts, 2 * np.array([car, truck]))
    tracks = figures["tracking"]["fused"]
    assert [tracks[name]["truth_tracks"] for name in ("car", "truck")] == [car[0], truck[0]]
    assert [tracks[name]["misses"] for name in ("car", "truck")] == [2 * (one[0] - one[1]) for one in (car, truck)]
