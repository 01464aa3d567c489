"""The smoother beside the weighted least squares of the whole track at once, for motion in a straight line."""

import numpy as np
import pytest

from lidcam.pipeline.tracking.smoothing import DRIFT_SIGMA_M, Cells, Courses, smoothed

ACCELERATION, PLACE = 0.7, 1e-3
NOISE = np.array([ACCELERATION, 1e-9, PLACE, 1e-9, 0.0])
START = np.diag([1.0, 1.0, 1e-8, 4.0, 1e-8])


def course(firsts: list[int], lasts: list[int]) -> Courses:
    count = len(firsts)
    return Courses(
        np.array(firsts),
        np.array(lasts),
        np.tile([0.0, 0.0, 0.0, 2.0, 0.0], (count, 1)),
        np.tile(START, (count, 1, 1)),
        np.tile(NOISE, (count, 1)),
        np.ones(count),
        np.zeros(count),
    )


def cells(xs: np.ndarray, are_seen: np.ndarray, sigma_m: float = 0.3) -> Cells:
    n = len(xs)
    boxes = np.column_stack([xs, np.zeros(n), np.zeros(n)])
    noise = np.tile(np.diag([sigma_m**2, 1e-4, 1e-4]), (n, 1, 1))
    return Cells(are_seen, boxes, noise, np.zeros(n), np.zeros(n, np.bool_))


STANDS = np.zeros((10, 2))
"""Positions of a rig that stands."""


def least_squares(xs: np.ndarray, are_seen: np.ndarray, stamps_s: np.ndarray, step_m: float = 0.0) -> np.ndarray:
    """(N, 2) place and speed at all times together."""
    n, sigma_m = len(xs), 0.3
    rows, right = [], []
    first = np.zeros((2, 2 * n))
    first[0, 0], first[1, 1] = 1.0, 0.5
    rows.append(first)
    right.append(np.array([0.0, 1.0]))
    for k in range(1, n):
        dt = stamps_s[k] - stamps_s[k - 1]
        spread = ACCELERATION * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) + np.diag(
            [PLACE * dt + DRIFT_SIGMA_M**2 * step_m, 0.0]
        )
        step = np.zeros((2, 2 * n))
        step[:, 2 * k : 2 * k + 2] = np.eye(2)
        step[:, 2 * k - 2 : 2 * k] = -np.array([[1, dt], [0, 1]])
        rows.append(np.linalg.inv(np.linalg.cholesky(spread)) @ step)
        right.append(np.zeros(2))
    for k in np.flatnonzero(are_seen).tolist():
        row = np.zeros((1, 2 * n))
        row[0, 2 * k] = 1 / sigma_m
        rows.append(row)
        right.append(xs[k : k + 1] / sigma_m)
    return np.asarray(np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]).reshape(n, 2)


@pytest.mark.parametrize(("missing", "step_m"), [([], 0.0), ([0, 3, 4, 5], 0.0), ([9], 2.0)])
def test_it_is_the_least_squares_of_the_whole_track(missing: list[int], step_m: float) -> None:
    stamps_s = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.7, 0.8, 0.9, 1.0])
    xs = 2.0 * stamps_s + np.random.default_rng(3).normal(size=10) * 0.2
    are_seen = np.ones(10, np.bool_)
    are_seen[missing] = False
    sites_xy = step_m * np.column_stack([np.arange(10.0), np.zeros(10)])
    found = smoothed(course([0], [9]), cells(xs, are_seen), stamps_s, sites_xy)
    np.testing.assert_allclose(found.states[:, [0, 3]], least_squares(xs, are_seen, stamps_s, step_m), atol=2e-3)


def test_tracks_do_not_change_each_other() -> None:
    stamps_s = np.linspace(0.0, 0.7, 8)
    xs, seen = np.arange(6) * 0.2, np.ones(6, np.bool_)
    alone = smoothed(course([2], [7]), cells(xs, seen), stamps_s, STANDS)
    both = smoothed(
        course([0, 2], [7, 7]), cells(np.concatenate([np.ones(8), xs]), np.ones(14, np.bool_)), stamps_s, STANDS
    )
    np.testing.assert_array_equal(both.states[8:], alone.states)


def test_no_track_has_no_cells() -> None:
    assert (
        len(
            smoothed(
                course([], []), cells(np.zeros(0), np.zeros(0, np.bool_)), np.linspace(0.0, 1.0, 3), np.zeros((3, 2))
            )
        )
        == 0
    )
