import numpy as np
import pytest
from pipeline.fusion.naming import OWN_LOG_ODDS, class_log_odds, confusion, vote_log_odds

from pipeline.core.arrays import F64
from pipeline.core.settings.classes import ROAD_CLASSES, ClassPrior

CAR, PEDESTRIAN, BICYCLE, TRUCK, BUS = range(5)
TAKEN_FOR = confusion(ROAD_CLASSES)


def by_size(size: tuple[float, float, float], own: int) -> F64:
    return class_log_odds(np.array([size]), np.array([own], np.int32), ROAD_CLASSES).reshape(-1)


def by_vote(class_id: int, score: float) -> F64:
    return vote_log_odds(np.array([class_id], np.int32), np.array([score]), TAKEN_FOR).reshape(-1)


def test_what_is_of_a_size_is_confused() -> None:
    np.testing.assert_allclose(TAKEN_FOR.sum(1), 1)
    assert (TAKEN_FOR.argmax(1) == np.arange(5)).all()
    assert TAKEN_FOR[TRUCK, BUS] > TAKEN_FOR[CAR, TRUCK] > TAKEN_FOR[CAR, BUS] > TAKEN_FOR[CAR, PEDESTRIAN]
    assert TAKEN_FOR[PEDESTRIAN, BICYCLE] > 5 * TAKEN_FOR[PEDESTRIAN, CAR]


def test_a_vote_says_more_with_a_higher_score_and_nothing_without() -> None:
    assert by_vote(CAR, 0.9)[CAR] > by_vote(CAR, 0.5)[CAR]
    np.testing.assert_allclose(by_vote(CAR, 0.0), by_vote(CAR, 0.0)[CAR])
    assert np.isfinite(by_vote(CAR, 1.0)).all()


def test_a_typical_box_is_of_its_class() -> None:
    for own, prior in enumerate(ROAD_CLASSES):
        odds = by_size(prior.size_m, own)
        assert odds.argmax() == own
        assert odds[own] == OWN_LOG_ODDS


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
