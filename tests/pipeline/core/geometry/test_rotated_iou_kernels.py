"""Shared grounds in one pass, judged by array operations."""

import numpy as np
import pytest

from pipeline.core.arrays import F64
from pipeline.core.geometry.rotated_iou import ROUNDING, BoxArrays, shared_ground

_ALONG, _ACROSS = np.array([[1, -1, -1, 1], [1, 1, -1, -1]])[:, :, None]


def judged(first: BoxArrays, second: BoxArrays) -> F64:
    """(P,) the integral over x, in the frame of the first box, of the height y that lies in both rectangles.

    Above each x, the second rectangle reaches from one of its edges up to another; both are cut off where the first one
    ends. So what its edges contribute, each with the sign of its direction, adds up to the area. No polygon is made
    whose corners could be confused where edges and corners meet: the area is continuous in what is given.
    """
    half_length, half_width = first.sizes[:, 0] / 2, first.sizes[:, 1] / 2
    cos, sin = np.cos(first.yaws), np.sin(first.yaws)
    east, north = (second.centers[:, :2] - first.centers[:, :2]).T
    turn = second.yaws - first.yaws
    along, across = _ALONG * (second.sizes[:, 0] / 2), _ACROSS * (second.sizes[:, 1] / 2)
    x = east * cos + north * sin + along * np.cos(turn) - across * np.sin(turn)  # (4, P), as all below
    y = north * cos - east * sin + along * np.sin(turn) + across * np.cos(turn)

    end_x, end_y = np.roll(x, -1, 0), np.roll(y, -1, 0)
    left, right = np.clip(x, -half_length, half_length), np.clip(end_x, -half_length, half_length)
    way_x, way_y = np.where(end_x == x, 1.0, end_x - x), end_y - y
    left_y = y + np.clip((left - x) / way_x, 0.0, 1.0) * way_y
    right_y = end_y - np.clip((end_x - right) / way_x, 0.0, 1.0) * way_y
    edges_m2 = (left - right) * mean_clipped(left_y, right_y, half_width)

    grounds_m2 = first.sizes[:, 0] * first.sizes[:, 1], second.sizes[:, 0] * second.sizes[:, 1]
    shared_m2 = np.minimum(edges_m2.sum(0), np.minimum(*grounds_m2))
    has_ground = (first.sizes[:, :2] > 0).all(1) & (second.sizes[:, :2] > 0).all(1)
    return np.where(has_ground & (shared_m2 > ROUNDING * (grounds_m2[0] + grounds_m2[1])), shared_m2, 0.0)


def mean_clipped(start: F64, end: F64, limit: F64) -> F64:
    """Mean of the numbers from `start` to `end`, each of them clipped to -`limit` .. `limit`."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    within_low, within_high = np.clip(low, -limit, limit), np.clip(high, -limit, limit)
    above, below = np.maximum(high, limit) - np.maximum(low, limit), np.minimum(high, -limit) - np.minimum(low, -limit)
    integral = (within_high - within_low) * (within_high + within_low) / 2 + limit * (above - below)
    return np.where(high > low, integral / np.where(high > low, high - low, 1.0), within_low)


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_same_as_by_array_operations(step: float) -> None:
    """With a step: whole steps, so that many sides and corners meet; some boxes have no ground."""
    random = np.random.default_rng(6)
    tables = random.uniform([-3, -3, 0, -0.2, -0.2, 1, -3], [3, 3, 1, 5, 5, 2, 3], (2, 3000, 7))
    tables = np.round(tables / step) * step if step else tables
    tables[..., 6] = np.where(random.random((2, 3000)) < 0.3, np.pi / 2, tables[..., 6])
    first, second = (BoxArrays(table[:, :3], table[:, 3:6], table[:, 6]) for table in tables)
    found = shared_ground(first, second)
    np.testing.assert_array_equal(found, judged(first, second))
    assert 500 < (found > 0).sum() < 2500


def test_what_is_not_finite_shares_nothing() -> None:
    boxes = BoxArrays(np.zeros((4, 3)), np.ones((4, 3)), np.zeros(4))
    for name in boxes._fields:
        for value in (np.nan, np.inf, -np.inf):
            odd = getattr(boxes, name).copy()
            odd[1:3] = value
            other = boxes._replace(**{name: odd})
            for pair in ((boxes, other), (other, boxes), (other, other)):
                found = shared_ground(*pair)
                assert (found[[0, 3]] == 1.0).all()
                assert (found[1:3] == 0.0).all() or (name == "sizes" and value == np.inf)
