"""Loops over the points of segments, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.begun.segment_kernels import extents_of_segments, points_of_segments


@pytest.mark.parametrize("seed", range(10))
def test_extents_and_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, size = 5, int(rng.integers(5, 400))
    segment = rng.permutation(np.concatenate([np.arange(count), rng.integers(0, count, size - count)]))
    frustum, reach_m = np.array([0, 0, 1, 2, 2]), np.array([1.0, 2.0, 0.0])
    along_m, share_x, share_y = rng.uniform(5, 9, size), rng.random(size), rng.random(size)
    along_m = np.round(along_m) if seed % 2 else along_m  # many alike
    order, starts, group, within, front, wide, high = extents_of_segments(
        segment, count, frustum[segment], along_m, share_x, share_y, reach_m
    )
    np.testing.assert_array_equal(order, np.argsort(segment, kind="stable"))
    np.testing.assert_array_equal(group, frustum)
    for s in range(count):
        rows = np.flatnonzero(segment == s)
        np.testing.assert_array_equal(order[starts[s] : starts[s + 1]], rows)
        assert front[s] == np.sort(along_m[rows])[len(rows) // 10]
        near = rows[along_m[rows] <= front[s] + reach_m[frustum[s]]]
        assert (within[s], wide[s], high[s]) == (len(near), np.ptp(share_x[near]), np.ptp(share_y[near]))

    chosen, ends_m = np.array([1, 4]), np.full(count, 7.0)
    points, first = points_of_segments(chosen, order, starts, along_m, ends_m)
    for s, part in zip(chosen, np.split(points, first[1:]), strict=True):
        np.testing.assert_array_equal(part, np.flatnonzero((segment == s) & (along_m <= 7.0)))


def test_no_segment_is_chosen() -> None:
    points, first = points_of_segments(np.zeros(0, np.int64), np.arange(3), np.array([0, 3]), np.ones(3), np.ones(1))
    assert len(points) == len(first) == 0
