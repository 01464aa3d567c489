from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes3d

from lidcam.pipeline.core.detections import Hypotheses, Source
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.core.settings.detect import Detect3DConfig
from lidcam.pipeline.stages.doubt import ANY_HEADING_VARIANCE, DoubtHeadings

CAR, PEDESTRIAN = ([prior.name for prior in ROAD_CLASSES].index(name) for name in ("car", "pedestrian"))
SIGMA_RAD = 0.05
ROW = (10, 0, 0.8, 4, 1.8, 1.5, 0)


def sigmas_deg(hypotheses: Hypotheses, method: str = "combined") -> list[Any]:
    config = Detect3DConfig.model_validate({"method": method})
    boxes = DoubtHeadings(config, ROAD_CLASSES)(hypotheses).boxes
    added = boxes.covariances - hypotheses.boxes.covariances
    excess_m2 = (hypotheses.boxes.sizes[:, 0] - hypotheses.boxes.sizes[:, 1]) ** 2
    wrong_share = added[:, 2, 2] / ANY_HEADING_VARIANCE
    np.testing.assert_allclose(added[:, :2, :2], (wrong_share * excess_m2 / 8)[:, None, None] * np.eye(2), atol=1e-12)
    return [*np.degrees(np.sqrt(boxes.covariances[:, 2, 2]))]


def hypotheses_of(*scores: float, class_id: int = CAR, points: int = 15) -> Hypotheses:
    n = len(scores)
    boxes = replace(
        boxes3d([ROW] * n, scores=scores, class_ids=[class_id] * n, deviations=(0.1, 0.2, SIGMA_RAD)),
        point_counts=np.full(n, points, np.int32),
    )
    return Hypotheses(boxes, {}, n)


def test_the_less_probable_a_vehicle_the_less_its_heading_says() -> None:
    assert sigmas_deg(hypotheses_of()) == []
    expected = [np.degrees(SIGMA_RAD), 7.9, 16.7, 22.2]
    assert sigmas_deg(hypotheses_of(1.0, 0.9, 0.5, 0.1)) == pytest.approx(expected, abs=0.1)
    of_points = [sigmas_deg(hypotheses_of(0.5, points=points))[0] for points in (0, 15, 40, 200)]
    assert of_points == pytest.approx([16.7, 16.7, 8.7, 3.3], abs=0.1)


def test_what_stays() -> None:
    as_fitted = [pytest.approx(np.degrees(SIGMA_RAD))]
    assert sigmas_deg(hypotheses_of(0.5, class_id=PEDESTRIAN)) == as_fitted
    assert sigmas_deg(hypotheses_of(0.5), "recorded") == as_fitted, "another detector says how sure it is"
    assert sigmas_deg(hypotheses_of(0.5), "cluster") == as_fitted, "its scores are no probabilities"
    found = hypotheses_of(0.5)
    by_camera = replace(found.boxes, sources=np.array([Source.CAMERA.value], np.uint8))
    assert sigmas_deg(replace(found, boxes=by_camera)) == as_fitted
    unknown = replace(found.boxes, covariances=np.zeros((1, 3, 3)))
    assert sigmas_deg(replace(found, boxes=unknown)) == [0]
