"""Points along a curve."""

import numpy as np
import pytest

from lidcam.pipeline.native.kernels import curve_order

CELLS, CROWD = 1 << 11, 256  # of curve.cpp


def test_a_walk_along_the_curve_goes_from_cell_to_cell() -> None:
    side = 8
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3)
    xyz = (cells * (CELLS // side)).astype(np.float32)
    xyz[cells.sum(1) == 3 * (side - 1)] = CELLS - 1  # the cube that the curve fills
    path = cells[curve_order(np.ascontiguousarray(xyz.T))]
    assert np.abs(np.diff(path, axis=0)).sum(axis=1).tolist() == [1] * (side**3 - 1)


@pytest.mark.parametrize("count", [1, 2, 1500])
def test_every_point_comes_once(count: int) -> None:
    xyz = np.random.default_rng(count).normal(size=(3, count)).astype(np.float32)
    assert sorted(curve_order(xyz).tolist()) == list(range(count))


def test_equal_points_keep_their_order() -> None:
    assert curve_order(np.full((3, 3 * CROWD), 2, np.float32)).tolist() == list(range(3 * CROWD))


def test_a_crowd_far_from_one_other_point_is_sorted_in_cells_of_its_own() -> None:
    rng = np.random.default_rng(1)
    crowd = rng.uniform(0, 1, (4000, 3))
    far = np.concatenate([crowd[:5], [[1e12, 0, 0], [0, 1e6, 0]], crowd[5:]]).astype(np.float32)
    order = curve_order(np.ascontiguousarray(far.T))
    steps = np.linalg.norm(np.diff(far[order[order > 6]], axis=0), axis=1)
    assert np.median(steps) < 0.1  # in any order: 0.7
