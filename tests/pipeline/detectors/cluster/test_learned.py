"""Learned class and score of clusters."""

import numpy as np
import pytest
from lidar_scene import Box, combined, rig, scan

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.detectors.cluster.kinds import kinds_of
from lidcam.pipeline.detectors.cluster.learned import LearnedScores
from lidcam.pipeline.stages.detect3d import Detect3D

LIDAR = (0.0, 0.0, 1.8)
CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)
GEOMETRIC, LEARNED = (
    load_config(settings=("detect3d.score=geometric",)),
    load_config(settings=("detect3d.score=learned",)),
)
REAR: Box = (12.0, 0.0, 0.75, 0.3, 1.8, 1.5, 0.0)
RIDER: Box = (8.0, 4.0, 0.95, 0.7, 0.4, 1.5, 1.0)


def test_kinds_of_classes() -> None:
    assert kinds_of(ROAD_CLASSES).nonzero()[1].tolist() == [1, 2, 3, 4, 4]
    motor = ClassPrior(
        name="vehicle", size_m=(4.5, 1.8, 1.6), max_size_m=(16, 3.2, 4.2), labels=("Car", "truck", "bus")
    )
    assert kinds_of([motor]).nonzero()[1].tolist() == [1, 4]
    assert kinds_of([ROAD_CLASSES[0].model_copy(update={"name": "CAR", "labels": ()})]).nonzero()[1].tolist() == [1]


@pytest.mark.parametrize(
    "prior",
    [
        ClassPrior(name="car", size_m=(0.33, 0.22, 0.21), max_size_m=(0.42, 0.28, 0.26)),
        ClassPrior(name="forklift", size_m=(2.5, 1.2, 2.1), max_size_m=(3, 1.5, 2.5)),
    ],
    ids=["model", "unknown"],
)
def test_other_classes_are_refused(prior: ClassPrior) -> None:
    with pytest.raises(ConfigError, match=f"found {prior.name}; set detect3d.score to geometric"):
        Detect3D(rig(LIDAR), LEARNED.model_copy(update={"classes": (*ROAD_CLASSES, prior)}))


class _Sure:
    """In place of a network: the same probabilities for all boxes."""

    def __init__(self, *probabilities: float) -> None:
        self._probabilities = np.array(probabilities)

    def __call__(self, features: F64) -> F64:
        return np.tile(self._probabilities, (len(features), 1))


@pytest.mark.parametrize(
    ("probabilities", "classes", "scores"),
    [
        ((0.1, 0.6, 0.1, 0.1, 0.1), [CAR, CAR], [0.6, 0.6]),
        ((0.1, 0.1, 0.1, 0.1, 0.6), [TRUCK, TRUCK], [0.6, 0.6]),  # of trucks and buses the first
        ((0.5, 0.1, 0.3, 0.1, 0.0), [CAR, PEDESTRIAN], [0.1, 0.3]),  # too large for a pedestrian
        ((0.97, 0.0, 0.0, 0.02, 0.01), [CAR, PEDESTRIAN], [0.0, 0.0]),  # no object, of whatever class
    ],
)
def test_the_class_is_the_most_probable_that_fits(
    probabilities: tuple[float, ...], classes: list[int], scores: list[float]
) -> None:
    cloud = combined(scan(LIDAR, [REAR, RIDER]))
    before = Detect3D(rig(LIDAR), GEOMETRIC)(cloud)
    assert before.class_ids.tolist() == [CAR, PEDESTRIAN]
    judge = LearnedScores(rig(LIDAR), LEARNED)
    vars(judge)["_network"] = _Sure(*probabilities)
    after = judge(cloud, before)
    assert after.class_ids.tolist() == classes
    np.testing.assert_allclose(after.scores, scores, atol=1e-6)
    same = after.class_ids == before.class_ids
    np.testing.assert_array_equal(after.sizes[same], before.sizes[same])
    assert (after.sizes[~same] != before.sizes[~same]).any(1).all()


def test_a_frame_without_boxes() -> None:
    assert not len(Detect3D(rig(LIDAR), LEARNED)(combined(np.zeros((0, 3)))))
    assert not len(Detect3D(rig(), LEARNED)(combined()))
