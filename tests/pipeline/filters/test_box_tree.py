"""Points along a curve, and boxes around them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.core.arrays import F32, I32
from pipeline.filters.box_tree import CELLS, CROWD, RUN, box_tree, curve_order

finite = st.floats(-1000, 1000, width=32)


def test_a_walk_along_the_curve_goes_from_cell_to_cell() -> None:
    side = 8
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3)
    xyz = (cells * (CELLS // side)).astype(np.float32)
    xyz[cells.sum(1) == 3 * (side - 1)] = CELLS - 1  # the cube that the curve fills
    path = cells[curve_order(xyz)]
    assert np.abs(np.diff(path, axis=0)).sum(axis=1).tolist() == [1] * (side**3 - 1)


@pytest.mark.parametrize("count", [0, 1, 2, 1500])
def test_every_point_comes_once(count: int) -> None:
    xyz = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    assert sorted(curve_order(xyz).tolist()) == list(range(count))


def test_equal_points_keep_their_order() -> None:
    assert curve_order(np.full((3 * CROWD, 3), 2, np.float32)).tolist() == list(range(3 * CROWD))


def test_a_crowd_far_from_one_other_point_is_sorted_in_cells_of_its_own() -> None:
    rng = np.random.default_rng(1)
    crowd = rng.uniform(0, 1, (4000, 3))
    far = np.concatenate([crowd[:5], [[1e12, 0, 0], [0, 1e6, 0]], crowd[5:]]).astype(np.float32)
    order = curve_order(far)
    steps = np.linalg.norm(np.diff(far[order[order > 6]], axis=0), axis=1)
    assert np.median(steps) < 0.1  # in any order: 0.7


def inside(xyz: F32, order: I32) -> None:
    """Checks that each box is the smallest around its points."""
    points, boxes, first = box_tree(xyz, order)
    slots = len(order) + -len(order) % RUN
    assert points.shape == (3, slots)
    padded = np.append(xyz[order], np.repeat(xyz[order[-1:]], slots - len(order), axis=0), axis=0)
    np.testing.assert_array_equal(points.T, padded)
    low, high = np.float32(np.inf), np.float32(-np.inf)
    lows = highs = padded
    for begin, end in pairwise(first):
        groups = -(-len(lows) // RUN)
        missing = groups * RUN - len(lows)
        lows = np.append(lows, np.full((missing, 3), low), axis=0).reshape(groups, RUN, 3).min(axis=1)
        highs = np.append(highs, np.full((missing, 3), high), axis=0).reshape(groups, RUN, 3).max(axis=1)
        children = np.moveaxis(boxes[begin:end], 2, 1).reshape(-1, 6)
        np.testing.assert_array_equal(children[:groups], np.column_stack([lows, highs]))
        assert (children[groups:, :3] > children[groups:, 3:]).all()
    assert len(lows) <= RUN
    assert first[0] == 0
    assert first[-1] == len(boxes)


@pytest.mark.parametrize("count", [1, RUN, RUN + 1, RUN**2, RUN**2 + 1, RUN**3 + 1])
def test_boxes(count: int) -> None:
    rng = np.random.default_rng(count)
    inside(rng.normal(size=(count, 3)).astype(np.float32), rng.permutation(count).astype(np.int32))


@given(xyz=st.integers(1, 600).flatmap(lambda n: arrays(np.float32, (n, 3), elements=finite, fill=finite)))
def test_boxes_along_the_curve(xyz: F32) -> None:
    inside(xyz, curve_order(xyz))
