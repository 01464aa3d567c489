import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.tracking.smoothing import Courses
from lidcam.pipeline.tracking.undersides import climb_variances, road_heights, smoothed_undersides, underside_variances


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


@pytest.mark.parametrize(("points", "slope"), [(1000, 0.05), (40, -0.08), (40, 0.0)])
def test_what_drives_uphill_is_followed_to_both_ends(points: int, slope: float) -> None:
    """One track that drives, and one that stands on the same road and is seen a little higher from afar."""
    tracks, are_seen = courses([0, 0], [49, 49]), np.ones(100, np.bool_)
    variances = underside_variances(np.full(100, points, np.int32))
    objects_m = np.concatenate([np.full(50, 0.6), np.zeros(50)])
    z_m = np.concatenate([slope * 0.6 * np.arange(50.0), np.linspace(0.0, 0.1, 50)])
    road_m = road_heights(tracks, are_seen, z_m, variances, objects_m)
    climbs = climb_variances(objects_m, np.zeros(100))
    found = road_m + smoothed_undersides(tracks, are_seen, z_m - road_m, variances, climbs)
    assert found[:50] == pytest.approx(z_m[:50], abs=0.03)
    assert not road_m[50:].any()
