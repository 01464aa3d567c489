from dataclasses import replace

import numpy as np
import pytest
from detections import boxes3d

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.association import class_confusion
from lidcam.pipeline.core.settings.classes import ROAD_CLASSES
from lidcam.pipeline.fusion.matching.agreement import (
    BoxBelief,
    MatchedPairs,
    agreed_with_others,
    before_matching,
    common_shifts,
    limited_slopes,
    prior_covariances,
    spread,
)

CAR, PEDESTRIAN, _, TRUCK, BUS = range(5)
CONFUSION = class_confusion(ROAD_CLASSES)
SEEN_ROWS = np.array([0, 1, 0, 0], np.int64)  # the first box in cameras 0, 1 and 2, the second in camera 0
JACOBIANS = np.random.default_rng(3).normal(0, 20, (4, 4, 3))
NOISE = np.full((4, 4), 4.0)


def belief(lidar_class: int = CAR) -> BoxBelief:
    covariances = np.tile(np.diag([0.04, 0.09, 0.01]), (2, 1, 1))
    return BoxBelief(covariances, np.log(CONFUSION).T[[lidar_class, lidar_class]], CONFUSION)


def pairs(seen: list[int], class_ids: list[int], differences: F64) -> MatchedPairs:
    rows = np.array(seen, np.int64)
    return MatchedPairs(
        rows, np.array(class_ids, np.int32), differences, NOISE[rows], np.full(len(seen), 4.0), JACOBIANS[rows]
    )


def test_each_camera_hears_the_others_only() -> None:
    random = np.random.default_rng(0)
    differences = random.normal(0, 3, (2, 4))
    others = agreed_with_others(belief(), SEEN_ROWS, pairs([0, 2], [CAR, CAR], differences))
    # Of the third box in view: by numpy, from the pairs 0 and 2; of the first: from the pair 2 alone. Weight 1 at 4.
    for row, heard in ((0, [1]), (2, [0]), (3, [0, 1])):
        J = JACOBIANS[[0, 2]][heard].reshape(-1, 3)
        normal = np.linalg.inv(np.diag([0.04, 0.09, 0.01])) + J.T @ J / 4
        np.testing.assert_allclose(others.covariances[row], np.linalg.inv(normal))
        np.testing.assert_allclose(others.shifts[row], np.linalg.solve(normal, J.T @ differences[heard].ravel() / 4))
    np.testing.assert_allclose(others.covariances[1], np.diag([0.04, 0.09, 0.01]))
    assert others.shifts[1].tolist() == [0, 0, 0]


def test_classes_of_the_others_count() -> None:
    matched = pairs([0, 2], [BUS, PEDESTRIAN], np.zeros((2, 4)))
    alone = before_matching(belief(TRUCK), SEEN_ROWS)
    true = (CONFUSION / CONFUSION.sum(0)).T  # by the class of the 3D box
    ratios = np.log(true @ CONFUSION * len(CONFUSION))
    np.testing.assert_allclose(alone.log_classes[0] + np.log(5), ratios[TRUCK])
    others = agreed_with_others(belief(TRUCK), SEEN_ROWS, matched)
    assert others.log_classes[2, PEDESTRIAN] < alone.log_classes[2, PEDESTRIAN], (
        "the first camera says that it is a bus"
    )
    assert others.log_classes[2, BUS] > alone.log_classes[2, BUS]
    assert others.log_classes[0, BUS] < alone.log_classes[0, BUS]
    np.testing.assert_allclose(np.exp(others.log_classes).sum(1), 1)


def test_without_pairs_the_box_speaks_for_itself() -> None:
    nothing = pairs([], [], np.zeros((0, 4)))
    others, alone = agreed_with_others(belief(), SEEN_ROWS, nothing), before_matching(belief(), SEEN_ROWS)
    np.testing.assert_allclose(others.covariances, alone.covariances)
    np.testing.assert_allclose(others.log_classes, alone.log_classes)
    assert not others.shifts.any()


def test_what_reaches_beside_the_camera_says_no_more_than_the_image_shows() -> None:
    """Two cameras have it in view; by the derivatives as they are, its covariance is singular."""
    covariances, widest = belief().covariances[SEEN_ROWS], np.full((4, 4), 900.0)
    slopes = limited_slopes(JACOBIANS * [[[1]], [[1]], [[1e15]], [[1e9]]], covariances, widest)
    np.testing.assert_array_equal(slopes[:2], limited_slopes(JACOBIANS, covariances, widest)[:2])
    assert spread(covariances, slopes).max() <= 900.0 * (1 + 1e-9)
    assert not limited_slopes(np.zeros((4, 4, 3)), covariances, widest).any()
    matched = pairs([2, 3], [CAR, CAR], np.ones((2, 4)))._replace(jacobians=slopes[2:])
    others = agreed_with_others(belief(), SEEN_ROWS, matched)
    assert (np.linalg.eigvalsh(others.covariances) > 0).all()
    assert np.abs(others.shifts).max() < 1.0


def test_unknown_covariances_are_guessed_by_size() -> None:
    boxes = boxes3d([(10, 0, 0, 4, 2, 1.5, 0), (10, 5, 0, 4, 2, 1.5, 0), (10, 9, 0, 0.6, 0.6, 1.7, 0)])
    known = boxes.covariances.copy()
    known[[0, 2]] = 0
    found = prior_covariances(replace(boxes, covariances=known))
    assert np.sqrt(found[0, 0, 0]) == pytest.approx(0.3, rel=1e-3)
    assert np.sqrt(found[2, 1, 1]) == pytest.approx(0.06, rel=1e-3)
    np.testing.assert_allclose(found[1], known[1], atol=1e-4 + 1e-12)


CAMERAS = np.array([0, 0, 0, 1, 1], np.int64)
PRIOR = np.full((5, 2), 25.0)


def test_each_pair_expects_the_shift_of_the_others_of_its_camera() -> None:
    matched = np.array([0, 2, 4], np.int64)
    away = np.array([[10.0, 1.0], [14.0, -1.0], [-30.0, 0.0]])
    variances, at_one_weight = np.full((3, 2), 16.0), np.full(3, 4.0)
    shifts, left = common_shifts(CAMERAS, PRIOR, matched, away, variances, at_one_weight)
    # A mean with the prior's: (z / 16) / (1 / 25 + n / 16).
    np.testing.assert_allclose(shifts[0], np.array([14, -1]) / 16 / (1 / 25 + 1 / 16))
    np.testing.assert_allclose(shifts[1], np.array([24, 0]) / 16 / (1 / 25 + 2 / 16))
    np.testing.assert_allclose(left[:, 0], 1 / (1 / 25 + np.array([1, 2, 1, 1, 0]) / 16))
    assert shifts[4].tolist() == [0, 0], "it does not speak for itself"
    np.testing.assert_allclose(shifts[3, 0], -30 / 16 / (1 / 25 + 1 / 16))


def test_what_lies_far_off_says_little() -> None:
    matched, variances = np.array([0, 1], np.int64), np.full((2, 2), 16.0)
    near, _ = common_shifts(CAMERAS, PRIOR, matched, np.full((2, 2), 40.0), variances, np.array([4.0, 4.0]))
    far, _ = common_shifts(CAMERAS, PRIOR, matched, np.full((2, 2), 40.0), variances, np.array([100.0, 100.0]))
    assert far[2, 0] < near[2, 0] / 2


def test_nothing_matched_and_a_calibration_without_errors() -> None:
    none = np.zeros(0, np.int64)
    shifts, left = common_shifts(CAMERAS, PRIOR, none, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    assert not shifts.any()
    np.testing.assert_array_equal(left, PRIOR)
    exact, left = common_shifts(
        CAMERAS, np.zeros((5, 2)), np.array([0], np.int64), np.ones((1, 2)), np.ones((1, 2)), np.ones(1)
    )
    assert not exact.any()
    assert not left.any()
