"""The loops over points, judged by array operations on all of them."""

import numpy as np
import pytest
from pipeline.fusion.begun.parting_kernels import boxes_that_hold, nearest_of_team


@pytest.mark.parametrize(("objects", "boxes"), [(0, 3), (4, 0), (12, 7)])
def test_boxes_that_hold_most_points(objects: int, boxes: int) -> None:
    random = np.random.default_rng(objects)
    xyz = random.uniform(-6, 6, (400, 3)).astype(np.float32)
    counts = random.integers(1, 30, objects)
    rows = random.integers(0, 400, counts.sum())
    ends = np.cumsum(counts)
    centers, half, yaws = random.uniform(-2, 2, (boxes, 3)), random.uniform(1, 7, (boxes, 3)), random.normal(size=boxes)
    cos, sin = np.cos(yaws), np.sin(yaws)
    found = boxes_that_hold(xyz, rows, ends, centers, half, cos, sin, 0.5)
    for end, count, own in zip(ends, counts, found, strict=True):
        x, y, z = np.moveaxis(xyz[rows[end - count : end], None].astype(np.float64) - centers, -1, 0)
        forward, left = x * cos + y * sin, y * cos - x * sin
        held = ((np.abs(forward) <= half[:, 0]) & (np.abs(left) <= half[:, 1]) & (np.abs(z) <= half[:, 2])).mean(0)
        assert own == (held.argmax() if boxes and held.max() > 0.5 else -1)


@pytest.mark.parametrize("count", [0, 1, 300])
def test_points_of_teams(count: int) -> None:
    random = np.random.default_rng(count)
    team = np.array([7, 3, 7, 9, 3])
    pairs = random.permutation(5 * 100)[:count]  # of a frustum and a point
    pairs.sort()
    group, rows = pairs // 100, pairs % 100
    aside = random.integers(0, 4, count) / 8
    order = np.lexsort((group, aside, rows, team[group]))
    key = np.stack([team[group][order], rows[order]])
    first = np.ones(count, np.bool_)
    first[1:] = (key[:, 1:] != key[:, :-1]).any(0)
    np.testing.assert_array_equal(nearest_of_team(rows, group, aside, team), np.sort(order[first]))
