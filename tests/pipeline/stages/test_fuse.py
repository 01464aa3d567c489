from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d, matches

from lidcam.pipeline.core.detections import Hypotheses
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.stages.fuse import Fuse

CLASSES = len(Config().classes)
PLACE = (5.0, 1.0, 0.5, 4.0, 1.8, 1.5, 0.3)


def fuse(min_score: float) -> Fuse:
    return Fuse(FuseConfig(min_score=min_score), class_count=CLASSES)


def test_what_is_probable_enough_is_an_object_and_its_score_the_probability() -> None:
    found = Hypotheses(boxes3d([PLACE] * 4), {"cam": matches([(1, 0), (3, 1)], np.zeros((4, 4)))}, 4)
    fused = fuse(0.5)(found, np.array([0.49, 0.5, 0.51, 0.9]))
    assert fused.rows.tolist() == [1, 2, 3]
    assert fused.matched.tolist() == [1, 0, 1]
    assert fused.objects.scores.tolist() == pytest.approx([0.5, 0.51, 0.9])
    np.testing.assert_array_equal(fused.objects.point_counts, found.boxes.point_counts[1:])
    assert found.boxes.scores.tolist() == [0.5] * 4, "the input is left as it was"


def test_what_is_there_and_of_no_class() -> None:
    x_m, points = [0.0, 20.0, 40.0, 41.0, 60.0, 0.5], [100, 100, 100, 30, 5, 100]
    boxes = boxes3d([(x, 0, 0.5, 4.0, 1.8, 1.5, 0.0) for x in x_m], scores=[0.3] * 6)
    boxes = replace(boxes, point_counts=np.array(points, np.int32))
    beliefs = np.array([0.9, 0.1, 0.1, 0.1, 0.1, 0.1])
    found = Hypotheses(boxes, {}, 6)
    names = Config(fuse=FuseConfig(unknown=True)).object_names
    fuse_all = Fuse(FuseConfig(unknown=True), class_count=CLASSES)
    fused = fuse_all(found, beliefs)
    assert fused.rows.tolist() == [0, 1, 2], "not: a part of another, too few points, on an object"
    assert [names[row] for row in fused.objects.class_ids] == ["car", "unknown", "unknown"]
    assert fused.objects.scores.tolist() == pytest.approx([0.9, 10 / 11, 10 / 11])
    assert fuse_all(replace(found, lidar_count=1), beliefs).rows.tolist() == [0], "2D boxes propose nothing unknown"
    assert Fuse(FuseConfig(), class_count=CLASSES)(found, beliefs).rows.tolist() == [0]
    nothing = Hypotheses(boxes.select(np.zeros(0, np.intp)), {}, 0)
    assert len(fuse_all(nothing, np.zeros(0)).rows) == 0
