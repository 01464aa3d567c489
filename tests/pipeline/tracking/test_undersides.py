import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.tracking.smoothing import Courses
from lidcam.pipeline.tracking.undersides import climb_variances, smoothed_undersides, underside_variances


def courses(firsts: list[int], lasts: list[int]) -> Courses:
    n = len(firsts)
    zeros = np.zeros((n, 5))
    first, last = np.array(firsts, np.int64), np.array(lasts, np.int64)
    return Courses(first, last, zeros, np.zeros((n, 5, 5)), zeros, np.zeros(n), np.zeros(n))


def least_squares(z_m: np.ndarray, variances: np.ndarray, climbs: np.ndarray) -> np.ndarray:
    """The most probable random walk of one track, by its normal equations."""
    steps = np.diff(np.eye(len(z_m)), axis=0)
    information = np.diag(1 / variances) + steps.T @ np.diag(1 / climbs[1:]) @ steps
    return np.asarray(np.linalg.solve(information, z_m / variances))


@given(seed=st.integers(0, 1000), lengths=st.lists(st.integers(1, 12), max_size=4))
def test_each_track_is_its_most_probable_random_walk(seed: int, lengths: list[int]) -> None:
    rng, count = np.random.default_rng(seed), sum(lengths)
    firsts = rng.integers(0, 5, len(lengths))
    tracks = courses([*firsts], [*(firsts + np.array(lengths, np.int64) - 1)])
    z_m, variances, climbs = rng.normal(size=count), rng.uniform(0.01, 1, count), rng.uniform(1e-4, 0.1, count)
    are_seen = rng.uniform(size=count) < 0.7
    are_seen[tracks.starts[:-1]] = True
    found = smoothed_undersides(tracks, are_seen, z_m, variances, climbs)
    unseen = np.where(are_seen, variances, 1e9)
    for first, last in zip(tracks.starts[:-1], tracks.starts[1:], strict=True):
        own = slice(first, last)
        np.testing.assert_allclose(found[own], least_squares(z_m[own], unseen[own], climbs[own]), atol=1e-5)


def test_a_parked_car_is_as_high_far_away_as_near() -> None:
    points = np.array([20] * 10 + [2000] * 10, np.int32)
    z_m = np.where(points == 20, 0.2, 0.0)
    climbs = climb_variances(np.zeros(20), np.ones(20))
    found = smoothed_undersides(courses([0], [19]), np.ones(20, np.bool_), z_m, underside_variances(points), climbs)
    assert found.max() < 0.05


def test_what_drives_uphill_is_followed() -> None:
    z_m = 0.05 * np.arange(30.0)
    climbs = climb_variances(np.ones(30), np.zeros(30))
    variances = underside_variances(np.full(30, 1000, np.int32))
    found = smoothed_undersides(courses([0], [29]), np.ones(30, np.bool_), z_m, variances, climbs)
    assert found == pytest.approx(z_m, abs=0.11)
