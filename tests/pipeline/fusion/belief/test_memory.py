import numpy as np
import numpy.typing as npt
import pytest
from detections import boxes3d

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.fusion.belief.memory import HALF_LIFE_S, MAX_AGE_S, MAX_COUNTED, PRIOR_RECALL, Memory, RecallCounts
from lidcam.pipeline.fusion.belief.odds import probability
from lidcam.pipeline.fusion.belief.visibility import Visibility

STILL = np.eye(4)
CAR, PEDESTRIAN = (4.0, 1.8, 1.5, 0.0), (0.6, 0.6, 1.7, 0.0)


def cars(*xy: tuple[float, float], class_id: int = 0, size: tuple[float, ...] = CAR) -> Boxes3D:
    return boxes3d([(*one, 0.0, *size) for one in xy], class_ids=[class_id] * len(xy))


def kept(boxes: Boxes3D, evidence: npt.ArrayLike) -> Memory:
    memory = Memory(Config().classes, 1)
    say(memory, boxes, np.array([evidence], np.float64))
    return memory


def say(memory: Memory, boxes: Boxes3D, evidence: npt.ArrayLike) -> None:
    """What each camera says of the boxes (C, N); NaN where one is not in its view, and in a row without image."""
    values = np.array(evidence, np.float64)
    memory.remember(boxes, np.isfinite(values), np.nan_to_num(values), np.asarray(np.isfinite(values).any(1)))


def asked(memory: Memory, boxes: Boxes3D, cameras: int = 1) -> F64:
    found = memory.recalled(boxes, np.ones((cameras, len(boxes)), np.bool_))
    return found[0] if cameras == 1 else found


@pytest.mark.parametrize(
    ("seconds", "share"), [(0.0, 1.0), (HALF_LIFE_S, 0.5), (MAX_AGE_S, 0.5 ** (1 / 0.3)), (1.01, 0), (-0.1, 0)]
)
def test_what_was_said_fades(seconds: float, share: float) -> None:
    memory = kept(cars((10, 0)), [4.0])
    memory.advance(seconds, STILL)
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
    memory.advance(0.1, STILL)
    assert (asked(memory, now)[0] > 0) == same


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_of_two_that_are_near_each_gets_its_own_and_once(order: list[int]) -> None:
    memory = kept(cars((10, 0), (10, 2)).select(np.array(order)), np.array([3.0, -2.0])[order])
    memory.advance(0.1, STILL)
    found = asked(memory, cars((10.3, 2), (10.3, 0), (10.3, 1)))
    fade = 0.5 ** (0.1 / HALF_LIFE_S)
    assert found.tolist() == pytest.approx([-2 * fade, 3 * fade, 0])


def test_it_moves_with_the_site_frame_and_forgets_where_that_is_not_known() -> None:
    memory = kept(cars((10, 0)), [1.0])
    T_now_then = np.array([[0.0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    memory.advance(0.0, T_now_then)
    assert asked(memory, cars((5, 10))).tolist() == [1.0]
    memory.advance(0.0, None)
    assert asked(memory, cars((5, 10))).tolist() == [0.0]


def test_what_other_cameras_said_is_kept_until_they_look() -> None:
    near, far, nan = (10, 0), (30, 0), np.nan
    memory = Memory(Config().classes, 2)
    say(memory, cars(near, far), [[1.0, 2.0], [3.0, nan]])
    say(memory, cars(near), [[nan], [5.0]])
    assert asked(memory, cars(near, far), 2).tolist() == [[1.0, 2.0], [5.0, 0.0]]
    memory.advance(HALF_LIFE_S, STILL)
    say(memory, cars(near), [[nan], [5.0]])
    assert asked(memory, cars(near, far), 2).tolist() == [[0.5, 1.0], [5.0, 0.0]], "what was said before is older"
    memory.advance(MAX_AGE_S - HALF_LIFE_S + 0.01, STILL)
    assert (asked(memory, cars(near, far), 2) > 0).tolist() == [[False, False], [True, False]]
    say(memory, cars(near), [[6.0], [7.0]])
    assert asked(memory, cars(near, far), 2).tolist() == [[6.0, 0.0], [7.0, 0.0]], "nothing is kept if all look"


SURE, DOUBTFUL = 5.0, -1.0


def views(
    camera: str, sizes_px: list[float], is_matched: list[bool], visible: float = 1.0, log_false: float = -50.0
) -> Visibility:
    shape = 1, len(sizes_px)
    zeros, yes, shown = np.zeros(shape), np.ones(shape, np.bool_), np.full(shape, visible)
    sizes, matched = np.array([sizes_px], np.float64), np.array([is_matched], np.bool_)
    return Visibility((camera,), yes, sizes, shown, ~yes, matched, zeros, zeros, zeros, np.array([log_false]))


def plain(recall: RecallCounts, camera: str, size_px: float) -> float:
    return float(recall.plain(views(camera, [size_px], [False]))[0, 0])


def learn(recall: RecallCounts, seen: Visibility, before: float, times: int = 1) -> float:
    """The probability that the camera sees, in the last frame."""
    others = probability(np.full(seen.size_px.shape, before))
    return [float(recall.learn(seen, others)[0, 0]) for _ in range(times)][-1]


@pytest.mark.parametrize(
    ("missed", "found", "log_false", "times", "sees"),
    [
        (0, 0, 0.0, 1, 1.0),  # nothing is there
        (4, 0, 0.0, 1, 0.0),
        (2, 0, 0.0, 1, 1.0),  # chance?
        (2, 0, 0.0, 3, 0.0),
        (4, 0, -5.0, 3, 1.0),  # it sees others
        (3, 1, -5.0, 3, 1.0),
    ],
)
def test_a_camera_without_a_true_2d_box_where_several_should_be_is_blind(
    missed: int, found: int, log_false: float, times: int, sees: float
) -> None:
    recall = RecallCounts(["cam"])
    seen = views("cam", [60.0] * (missed + found), [False] * missed + [True] * found, log_false=log_false)
    assert learn(recall, seen, SURE, times) == pytest.approx(sees, abs=0.3)
    assert learn(recall, views("cam", [60.0] * 3, [True] * 3, log_false=-6.0), SURE) > 0.9, "it sees again"


def test_blind_frames_say_nothing_of_a_detector() -> None:
    recall = RecallCounts(["cam"])
    learn(recall, views("cam", [60.0] * 4, [False] * 4, log_false=0.0), SURE, times=100)
    assert plain(recall, "cam", 60) > 0.8 * PRIOR_RECALL[3]


def test_a_camera_that_sees_nothing_loses_its_say() -> None:
    recall = RecallCounts(["blind", "good"])
    for _ in range(60):
        learn(recall, views("blind", [60.0], [False]), SURE)
        learn(recall, views("good", [60.0], [True]), SURE)
    assert plain(recall, "blind", 60) < 0.25
    assert plain(recall, "good", 60) > 0.8
    assert plain(recall, "good", 300) == pytest.approx(PRIOR_RECALL[-1]), "of other sizes nothing is known"


def test_a_new_camera_is_taken_to_be_like_the_others() -> None:
    recall = RecallCounts(["one", "two"])
    learn(recall, views("one", [60.0], [False]), SURE, times=50)
    assert plain(recall, "one", 60) < plain(recall, "two", 60) < PRIOR_RECALL[3]


@pytest.mark.parametrize(("visible", "before"), [(0.5, SURE), (1.0, DOUBTFUL)], ids=["hidden", "doubtful"])
def test_what_tells_nothing_is_not_counted(visible: float, before: float) -> None:
    recall = RecallCounts(["cam"])
    learn(recall, views("cam", [60.0], [False], visible), before, times=50)
    assert plain(recall, "cam", 60) == pytest.approx(PRIOR_RECALL[3])


def test_what_was_long_ago_fades() -> None:
    recall = RecallCounts(["cam"])
    learn(recall, views("cam", [60.0] * 10, [True] * 10), SURE, times=1000)
    learn(recall, views("cam", [60.0] * 10, [False] * 10), SURE, times=int(MAX_COUNTED) // 10)
    assert 0.2 < plain(recall, "cam", 60) < 0.6
