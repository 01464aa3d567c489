import numpy as np
import pytest

from pipeline.core.arrays import F64
from pipeline.fusion.belief.memory import MEMORY, PRIOR_RECALL, RecallCounts
from pipeline.fusion.belief.odds import FITTED
from pipeline.fusion.belief.visibility import Visibility

SURE, DOUBTFUL = 5.0, -1.0


def views(camera: str, sizes_px: list[float], is_matched: list[bool], visible: float = 1.0) -> Visibility:
    shape = 1, len(sizes_px)
    zeros, yes = np.zeros(shape), np.ones(shape, np.bool_)
    return Visibility(
        (camera,),
        yes,
        np.array([sizes_px], np.float64),
        np.full(shape, visible),
        ~yes,
        np.array([is_matched], np.bool_),
        zeros,
        zeros.copy(),
    )


def plain(recall: RecallCounts, camera: str, size_px: float) -> float:
    return float(recall.plain(views(camera, [size_px], [False]))[0, 0])


def learn(recall: RecallCounts, seen: Visibility, before: float, times: int = 1) -> None:
    odds: F64 = np.full(seen.size_px.shape[1], before)
    for _ in range(times):
        recall.learn(seen, odds, np.zeros(seen.size_px.shape), FITTED)


def test_the_prior_grows_with_size() -> None:
    recall = RecallCounts(["cam"])
    assert [plain(recall, "cam", size) for size in (5, 20, 30, 60, 300)] == pytest.approx(PRIOR_RECALL)


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
    learn(recall, views("cam", [60.0] * 10, [False] * 10), SURE, times=int(MEMORY) // 10)
    assert 0.2 < plain(recall, "cam", 60) < 0.6


def test_a_recall_that_is_set_is_not_learned() -> None:
    recall = RecallCounts(["cam"], 0.5)
    learn(recall, views("cam", [300.0], [True]), SURE, times=50)
    assert plain(recall, "cam", 300) == pytest.approx(0.5)
    assert plain(recall, "cam", 5) == pytest.approx(0.5 * PRIOR_RECALL[0] / PRIOR_RECALL[-1])


def test_no_hypotheses() -> None:
    recall = RecallCounts(["cam"])
    learn(recall, views("cam", [], []), SURE)
    assert recall.plain(views("cam", [], [])).shape == (1, 0)
