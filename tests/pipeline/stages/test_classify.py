from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d, matches

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior
from lidcam.pipeline.stages.classify import Classify, class_log_odds, confusion

CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)
SIZES = [prior.size_m for prior in ROAD_CLASSES]
VAN = (4.6, 1.9, 2.05)
SALOON = (4.3, 1.75, 1.5)
Vote = tuple[float, int]


def seen(score: float, class_id: int) -> Boxes2D:
    return boxes2d([(0, 0, 10, 10, score, class_id)])


def classified(
    size: tuple[float, float, float],
    own: int,
    votes: Sequence[Vote],
    *,
    riders: frozenset[tuple[int, int]] = frozenset(),
    by_lidar: bool = True,
    score: float | None = None,
) -> int:
    boxes = boxes3d([(5.0, 1.0, 0.5, *size, 0.3)], class_ids=[own])
    boxes = replace(boxes, scores=np.full(1, 0.5 if score is None else score, np.float32))
    found = {f"cam{i}": seen(*vote) for i, vote in enumerate(votes)}
    given = Hypotheses(boxes, {name: matches([(0, 0)], np.zeros((1, 4))) for name in found}, int(by_lidar))
    classify = Classify(ROAD_CLASSES, riders, score_groups=None if score is None else np.array([0, 1, 2, 3, 3]))
    return int(classify(given, found).boxes.class_ids[0])


@pytest.mark.parametrize(
    ("size", "own", "votes", "class_id"),
    [
        pytest.param(SIZES[CAR], CAR, [], CAR, id="no camera"),
        pytest.param(SIZES[CAR], CAR, [(0.9, CAR)], CAR, id="agreed"),
        pytest.param(SALOON, CAR, [(0.9, BUS)], CAR, id="one vote makes a car no bus"),
        pytest.param(SALOON, CAR, [(0.9, BUS), (0.9, BUS), (0.9, BUS)], BUS, id="three do"),
        pytest.param(VAN, CAR, [(0.9, TRUCK)], TRUCK, id="a van is a truck if a camera says so"),
        pytest.param(SIZES[CAR], CAR, [(0.8, TRUCK)], TRUCK, id="and so is what was completed"),
        pytest.param(VAN, CAR, [(0.9, CAR)], CAR, id="and a car if it does not"),
        pytest.param(SIZES[PEDESTRIAN], PEDESTRIAN, [(0.6, BICYCLE)], BICYCLE, id="a rider"),
        pytest.param(SIZES[BICYCLE], BICYCLE, [(0.8, PEDESTRIAN)], PEDESTRIAN, id="no rider"),
        pytest.param(SIZES[TRUCK], TRUCK, [(0.9, BUS)], BUS, id="what looks alike goes by the camera"),
        pytest.param((9.0, 2.6, 3.3), TRUCK, [(0.9, CAR)], TRUCK, id="what is too large for a car is none"),
        pytest.param((15.0, 2.55, 3.4), BUS, [(0.45, TRUCK)], TRUCK, id="a semi-trailer is a truck"),
        pytest.param(SIZES[CAR], CAR, [(0.0, PEDESTRIAN)], CAR, id="a vote of no score"),
    ],
)
def test_class(size: tuple[float, float, float], own: int, votes: list[Vote], class_id: int) -> None:
    assert classified(size, own, votes) == class_id


def test_a_person_on_what_the_lidars_take_for_a_bicycle_rides_it_if_the_network_knows_no_riders() -> None:
    riders, votes = frozenset({(BICYCLE, PEDESTRIAN)}), [(0.8, PEDESTRIAN)]
    assert classified(SIZES[BICYCLE], BICYCLE, votes, riders=riders) == BICYCLE
    assert classified(SIZES[PEDESTRIAN], PEDESTRIAN, votes, riders=riders) == PEDESTRIAN
    assert classified(SIZES[BICYCLE], BICYCLE, votes, riders=riders, by_lidar=False) == PEDESTRIAN, "2D boxes made it"


@pytest.mark.parametrize(
    ("score", "own", "class_id"), [(0.48, BICYCLE, PEDESTRIAN), (0.9, BICYCLE, BICYCLE), (0.48, PEDESTRIAN, PEDESTRIAN)]
)
def test_the_lidars_score_decides_whether_a_person_rides(score: float, own: int, class_id: int) -> None:
    riders, votes = frozenset({(BICYCLE, PEDESTRIAN)}), [(0.92, PEDESTRIAN)]
    assert classified(SIZES[own], own, votes, riders=riders, score=score) == class_id


def test_the_lidars_score_of_a_large_vehicle_makes_it_neither_truck_nor_bus() -> None:
    assert classified((6.8, 2.3, 2.8), TRUCK, [(0.86, BUS), (0.81, BUS)], score=0.78) == BUS
    assert classified((6.8, 2.3, 2.8), TRUCK, [(0.86, CAR)], score=0.78) == TRUCK


def test_no_boxes() -> None:
    given = Hypotheses(boxes3d([]), {"cam": matches([], [])}, 0)
    assert len(Classify(ROAD_CLASSES)(given, {"cam": seen(0.5, CAR)}).boxes) == 0


def by_size(size: tuple[float, float, float], own: int) -> F64:
    return class_log_odds(np.array([size]), np.array([own], np.int32), ROAD_CLASSES).reshape(-1)


def test_measured_extents_count_and_completed_ones_are_no_longer_than_that() -> None:
    assert by_size((4.0, 1.7, 2.0), CAR)[CAR] < by_size((4.0, 1.7, 1.55), CAR)[CAR]
    assert by_size((8.0, 2.5, 3.2), TRUCK)[CAR] == 0, "all of it was completed"
    assert by_size((8.0, 2.5, 3.0), TRUCK)[CAR] < -2, "its height was measured"
    assert by_size((4.3, 1.75, 1.5), CAR)[BUS] < -2, "a bus would be higher"
    assert by_size((4.0, 1.7, 1.55), CAR)[BUS] > by_size((4.3, 1.75, 1.5), CAR)[BUS], "completed: it may be higher"
    assert np.isfinite(by_size((18.0, 3.1, 4.1), BUS)).all()


def test_the_one_side_that_was_measured_may_be_the_length_of_another_class() -> None:
    assert by_size((4.0, 1.45, 1.6), CAR)[BICYCLE] > -0.5, "as long as a bicycle, the rest was completed"
    assert by_size((3.9, 1.45, 1.6), CAR)[BICYCLE] < -2, "both were measured"
    assert by_size((4.0, 1.7, 1.4), CAR)[TRUCK] < -1, "no truck is so short"
    assert by_size((4.0, 1.45, 1.6), CAR)[CAR] < by_size((4.0, 1.6, 1.6), CAR)[CAR], (
        "no car is turned for its own class"
    )


@pytest.mark.parametrize("count", [0, 3])
def test_one_class(count: int) -> None:
    only = (ClassPrior(name="car", size_m=(0.3, 0.2, 0.2), max_size_m=(0.3, 0.2, 0.2)),)
    assert confusion(only).tolist() == [[1.0]]
    odds = class_log_odds(np.full((count, 3), 0.5), np.zeros(count, np.int32), only)
    assert odds.shape == (count, 1)
    assert np.isfinite(odds).all()
