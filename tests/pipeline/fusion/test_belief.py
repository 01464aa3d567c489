from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.detections import Source
from pipeline.fusion.belief import (
    FITTED,
    camera_evidence,
    joined,
    log_odds_before_cameras,
    logit,
    probability,
)
from pipeline.fusion.looks import Looks

SCORE = st.floats(0, 1)


def looks(
    *,
    in_view: bool = True,
    visible: float = 1.0,
    is_cut: bool = False,
    is_matched: bool = False,
    score: float = 0.0,
    iou: float = 0.0,
    rivals: float = 0.0,
) -> Looks:
    """One camera that has one whole box of 60 px in plain view, without a match unless a value says so."""
    flags = (np.array([[flag]], np.bool_) for flag in (in_view, is_cut, is_matched))
    values = (np.array([[value]], np.float64) for value in (60.0, visible, score, iou, rivals))
    view, cut, matched = flags
    size_px, shown, scores, overlap, others = values
    return Looks(("cam",), view, size_px, shown, cut, matched, scores, overlap, others)


def evidence(found: Looks, recall: float = 0.9) -> float:
    return float(camera_evidence(found, np.full((1, 1), recall), FITTED)[0, 0])


def test_probabilities_and_log_odds_are_each_others_inverse_within_limits() -> None:
    p = np.array([0.01, 0.3, 0.5, 0.99])
    np.testing.assert_allclose(probability(logit(p)), p)
    assert np.isfinite(logit(np.array([0.0, 1.0]))).all()
    assert 0 < probability(np.array([-1e9]))[0] < probability(np.array([1e9]))[0] < 1


@given(SCORE, SCORE)
def test_a_higher_score_of_the_lidars_is_more_probable(one: float, two: float) -> None:
    scores = np.array(sorted((one, two)))
    found = log_odds_before_cameras(scores, np.ones(2), np.zeros(2, np.uint8), np.ones(2, np.bool_), FITTED)
    assert found[0] <= found[1]


def test_what_was_begun_from_a_2d_box_has_less_behind_it_without_points() -> None:
    sources = np.array([Source.LIDAR, Source.BOTH, Source.CAMERA], np.uint8)
    is_lidar = np.array([True, False, False])
    odds = log_odds_before_cameras(np.full(3, 0.5), np.full(3, 2.0), sources, is_lidar, FITTED)
    assert odds[1:].tolist() == [FITTED.led, FITTED.placed]


def test_a_match_speaks_for_and_silence_against() -> None:
    usual = evidence(looks(is_matched=True, score=0.6, iou=0.7))
    assert usual > 0 > evidence(looks())
    assert evidence(looks(is_matched=True, score=0.9, iou=0.7)) > usual
    assert evidence(looks(is_matched=True, score=0.6, iou=0.4)) < usual
    assert evidence(looks(is_matched=True, score=0.6, iou=0.7, rivals=3)) < usual


def test_silence_of_a_camera_that_could_not_see_it_says_nothing() -> None:
    assert evidence(looks(in_view=False)) == evidence(looks(visible=0.2)) == evidence(looks(), 0.0) == 0


def test_silence_says_less_of_what_is_harder_to_see() -> None:
    assert evidence(looks()) < evidence(looks(visible=0.6)) < 0
    assert evidence(looks()) < evidence(looks(is_cut=True)) < 0
    assert evidence(looks(), 0.9) < evidence(looks(), 0.5) < 0
    assert np.isfinite(evidence(looks(), 1.0))


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=8))
def test_cameras_join_in_any_order_and_each_adds_what_it_says(values: list[float]) -> None:
    column = np.array(values)[:, None]
    whole = joined(column, FITTED)[0]
    assert joined(column[::-1], FITTED)[0] == pytest.approx(whole)
    assert joined(column[:1], FITTED)[0] == pytest.approx(values[0])
    more = joined(np.append(column, [[1.0]], 0), FITTED)[0]
    assert more >= whole - 1e-9
    assert joined(np.append(column, [[0.0]], 0), FITTED)[0] == pytest.approx(whole)


def test_further_cameras_count_less_than_the_first() -> None:
    two = joined(np.array([[2.0], [2.0]]), replace(FITTED, further=0.5))[0]
    assert two == pytest.approx(3.0)


def test_no_cameras() -> None:
    assert joined(np.zeros((0, 3)), FITTED).tolist() == [0, 0, 0]
