import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.detectors.log_odds import SCORE_LIMIT, logit
from lidcam.pipeline.fusion.belief.odds import (
    CUT_RECALL,
    FITTED,
    PEOPLE_LOG_ODDS,
    VEHICLE_SHARE,
    camera_evidence,
    joined,
    joined_without_each,
    log_odds_before_cameras,
    match_radii_m,
    position_probability,
    probability,
    view_shares,
)
from lidcam.pipeline.fusion.belief.visibility import Visibility

LIDAR = np.full(3, 20, np.int32), np.zeros(3, np.uint8), np.ones(3, np.bool_)
"""Points, sources, and whether the lidars found them."""


def views(
    *,
    in_view: bool = True,
    visible: float = 1.0,
    is_cut: bool = False,
    is_matched: bool = False,
    score: float = 0.0,
    iou: float = 0.0,
    agreement: float = 0.0,
) -> Visibility:
    """One camera that has one whole box of 60 px in plain view, without a match unless a value says so."""
    flags = (np.array([[flag]], np.bool_) for flag in (in_view, is_cut, is_matched))
    values = (np.array([[value]], np.float64) for value in (60.0, visible, score, iou, agreement))
    view, cut, matched = flags
    size_px, shown, scores, overlap, agreed = values
    return Visibility(("cam",), view, size_px, shown, cut, matched, scores, overlap, agreed, np.zeros(1))


def evidence(found: Visibility, recall: float = 0.9) -> float:
    return float(camera_evidence(found, np.full((1, 1), recall), FITTED)[0, 0])


def test_probabilities_and_log_odds_are_each_others_inverse_within_limits() -> None:
    p = np.array([0.01, 0.3, 0.5, 0.99])
    np.testing.assert_allclose(probability(logit(p)), p, atol=0.01)
    assert np.isfinite(logit(np.array([0.0, 1.0]))).all()
    assert 0 < probability(np.array([-1e9]))[0] < probability(np.array([1e9]))[0] < 1


def test_what_is_certain_keeps_its_order() -> None:
    certain = probability(np.array([-40.0, -20.0, 6.0, 10.0, 20.0, 40.0])).astype(np.float32)
    assert (np.diff(certain) > 0).all()
    assert certain[-1] < 1 - SCORE_LIMIT, "trackers take its log odds"


def test_where_an_object_is() -> None:
    covariances = np.zeros((4, 3, 3))
    covariances[:, [0, 1], [0, 1]] = np.array([[0.0], [0.01], [1.0], [100.0]])
    place = position_probability(covariances, np.full(4, 2.0))
    assert place.tolist() == pytest.approx([1, 1, 1 - np.exp(-2), 1 - np.exp(-0.02)])
    assert match_radii_m(ROAD_CLASSES)[:2].tolist() == [2.0, 0.875]


def test_what_a_2d_box_proposes_has_less_behind_it_without_points() -> None:
    sources = np.array([Source.LIDAR, Source.BOTH, Source.CAMERA], np.uint8)
    is_lidar = np.array([True, False, False])
    odds = log_odds_before_cameras(np.full(3, 0.5), np.ones(3), LIDAR[0], sources, is_lidar, FITTED)
    assert odds[1:].tolist() == [FITTED.frustum, FITTED.placed]


def before(score: float, in_view: float, *, is_upright: bool) -> float:
    """Log odds of a network's box of 20 points."""
    upright, ones = np.array([is_upright]), np.ones(1)
    measured = np.array([score]), ones, LIDAR[0][:1], LIDAR[1][:1], LIDAR[2][:1], FITTED
    shares = np.array([[in_view], [in_view > 0]])
    return float(log_odds_before_cameras(*measured, in_view=shares, are_upright=upright)[0])


def test_a_networks_box_counts_less_as_far_as_a_camera_sees_it() -> None:
    plain = float(logit(np.array(0.9)))
    assert [before(0.9, view, is_upright=True) for view in (0.0, 0.5, 1.0)] == pytest.approx(
        [plain, plain + (FITTED.in_view + PEOPLE_LOG_ODDS) / 2, plain + FITTED.in_view + PEOPLE_LOG_ODDS]
    )
    assert before(0.9, 0.5, is_upright=False) == pytest.approx(plain + VEHICLE_SHARE * FITTED.in_view)


@pytest.mark.parametrize(
    ("seen", "shares"),
    [
        (views(), [1, 0.9]),
        (views(visible=0.35), [0.5, 0.9]),
        (views(visible=0.1), [0, 0]),
        (views(in_view=False), [0, 0]),
        (views(is_cut=True), [CUT_RECALL, CUT_RECALL * 0.9]),
    ],
)
def test_how_well_a_camera_sees_a_box(seen: Visibility, shares: list[float]) -> None:
    assert view_shares(seen, np.array([[0.9]]))[:, 0, 0].tolist() == pytest.approx(shares)


def test_improbable_people_in_view_are_as_probable_as_what_a_2d_box_proposes() -> None:
    assert before(0.02, 1.0, is_upright=True) == FITTED.frustum + PEOPLE_LOG_ODDS
    assert before(0.02, 0.0, is_upright=True) < FITTED.frustum
    assert before(0.02, 1.0, is_upright=False) < FITTED.frustum


def test_a_match_speaks_for_and_silence_against() -> None:
    usual = evidence(views(is_matched=True, score=0.6, iou=0.7))
    assert usual > 0 > evidence(views())
    assert evidence(views(is_matched=True, score=0.9, iou=0.7)) > usual
    assert evidence(views(is_matched=True, score=0.6, iou=0.4)) < usual


def test_a_box_of_something_else_says_less_and_no_more_against_it_than_none() -> None:
    usual = evidence(views(is_matched=True, score=0.6, iou=0.7))
    assert 0 < evidence(views(is_matched=True, score=0.6, iou=0.7, agreement=-1.0)) < usual
    assert evidence(views(is_matched=True, score=0.6, iou=0.7, agreement=-50.0)) == evidence(views())


def test_silence_of_a_camera_that_could_not_see_it_says_nothing() -> None:
    assert evidence(views(in_view=False)) == evidence(views(visible=0.1)) == evidence(views(), 0.0) == 0


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=8))
def test_cameras_join_in_any_order_and_each_adds_what_it_says(values: list[float]) -> None:
    column = np.array(values)[:, None]
    whole = joined(column, FITTED)[0]
    assert joined(column[::-1], FITTED)[0] == pytest.approx(whole)
    assert joined(column[:1], FITTED)[0] == pytest.approx(values[0])
    more = joined(np.append(column, [[1.0]], 0), FITTED)[0]
    assert more >= whole - 1e-9
    assert joined(np.append(column, [[0.0]], 0), FITTED)[0] == pytest.approx(whole)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=6), st.sampled_from([0.3, 0.7, 1.0]))
def test_without_each_camera_in_turn(values: list[float], further: float) -> None:
    column, by = np.array(values)[:, None], FITTED._replace(further=further)
    expected = [joined(np.delete(column, row, 0), by)[0] for row in range(len(values))]
    assert joined_without_each(column, by)[:, 0].tolist() == pytest.approx(expected)
