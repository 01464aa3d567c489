import numpy as np
import numpy.typing as npt
import pytest
from detections import boxes3d

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D
from pipeline.core.settings.config import Config
from pipeline.fusion.belief.memory import HALF_LIFE_S, MAX_AGE_S, Memory

STILL = np.eye(4)
CAR, PEDESTRIAN = (4.0, 1.8, 1.5, 0.0), (0.6, 0.6, 1.7, 0.0)


def cars(*xy: tuple[float, float], class_id: int = 0, size: tuple[float, ...] = CAR) -> Boxes3D:
    return boxes3d([(*one, 0.0, *size) for one in xy], class_ids=[class_id] * len(xy))


def kept(boxes: Boxes3D, evidence: npt.ArrayLike) -> Memory:
    memory = Memory(Config().classes)
    memory.remember(boxes, np.ones(len(boxes), np.bool_), np.array(evidence, np.float64), all_look=True)
    return memory


def asked(memory: Memory, boxes: Boxes3D) -> F64:
    return memory.recalled(boxes, np.ones(len(boxes), np.bool_))


@pytest.mark.parametrize(
    ("seconds", "share"), [(0.0, 1.0), (HALF_LIFE_S, 0.5), (MAX_AGE_S, 0.5 ** (1 / 0.3)), (1.01, 0), (-0.1, 0)]
)
def test_what_was_said_fades(seconds: float, share: float) -> None:
    memory = kept(cars((10, 0)), [4.0])
    memory.age(seconds, STILL)
    assert asked(memory, cars((10, 0))).tolist() == pytest.approx([4.0 * share])


@pytest.mark.parametrize(
    ("then", "now", "same"),
    [
        (cars((10, 0)), cars((11.5, 0)), True),
        (cars((10, 0)), cars((12.5, 0)), False),
        (cars((10, 0)), cars((10, 0), class_id=3), False),
        (cars((10, 0)), cars((10, 0), size=(1.0, 1.8, 1.5, 0.0)), False),
        (cars((5, 0), class_id=1, size=PEDESTRIAN), cars((5.3, 0), class_id=1, size=PEDESTRIAN), True),
        (cars((5, 0), class_id=1, size=PEDESTRIAN), cars((5.6, 0), class_id=1, size=PEDESTRIAN), False),
    ],
)
def test_how_far_a_class_moves_in_a_tenth_of_a_second(then: Boxes3D, now: Boxes3D, same: bool) -> None:
    memory = kept(then, [1.0])
    memory.age(0.1, STILL)
    assert (asked(memory, now)[0] > 0) == same


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_of_two_that_are_near_each_gets_its_own_and_once(order: list[int]) -> None:
    memory = kept(cars((10, 0), (10, 2)).select(np.array(order)), np.array([3.0, -2.0])[order])
    memory.age(0.1, STILL)
    found = asked(memory, cars((10.3, 2), (10.3, 0), (10.3, 1)))
    fade = 0.5 ** (0.1 / HALF_LIFE_S)
    assert found.tolist() == pytest.approx([-2 * fade, 3 * fade, 0])


def test_it_moves_with_the_site_frame_and_forgets_where_that_is_not_known() -> None:
    memory = kept(cars((10, 0)), [1.0])
    T_now_then = np.array([[0.0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    memory.age(0.0, T_now_then)
    assert asked(memory, cars((5, 10))).tolist() == [1.0]
    memory.age(0.0, None)
    assert asked(memory, cars((5, 10))).tolist() == [0.0]


def test_what_other_cameras_said_is_kept_until_it_is_said_anew() -> None:
    memory = kept(cars((10, 0), (30, 0)), [1.0, 2.0])
    memory.remember(cars((10, 0)), np.ones(1, np.bool_), np.array([5.0]), all_look=False)
    assert asked(memory, cars((10, 0), (30, 0))).tolist() == [5.0, 2.0]
    memory.remember(cars((10, 0)), np.ones(1, np.bool_), np.array([6.0]), all_look=True)
    assert asked(memory, cars((10, 0), (30, 0))).tolist() == [6.0, 0.0]


def test_nothing_is_asked_and_nothing_is_known() -> None:
    memory = kept(cars(), [])
    memory.age(0.1, STILL)
    assert asked(memory, cars((1, 1))).tolist() == [0.0]
    assert asked(kept(cars((1, 1)), [1.0]), cars()).shape == (0,)
    assert kept(cars((1, 1)), [1.0]).recalled(cars((1, 1)), np.zeros(1, np.bool_)).tolist() == [0.0]
