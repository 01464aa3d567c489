import numpy as np
from pipeline.fusion.matching.aiming import common_shifts

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
