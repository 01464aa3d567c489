"""Depths and what they hide, against the same in array arithmetic."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.belief.occlusion_kernels import nearer_shares, nearest_in_cells

from pipeline.core.arrays import F32, F64
from pipeline.core.geometry.boxes import box_corners

COLUMNS, ROWS, NEAR_M = 8, 6, 0.1
LOW, CELL = np.array([[-1.0, -0.75], [-0.8, -0.6]]), np.array([[0.25, 0.25], [0.2, 0.2]])


def two_cameras(random: np.random.Generator) -> F64:
    matrices = np.tile(np.eye(4), (2, 1, 1))
    matrices[:, :3, 3] = random.normal(0, 0.5, (2, 3))
    matrices[1, :3, :3] = np.diag([-1.0, 1.0, -1.0])
    return matrices


def moved(matrix: F64, xyz: F64) -> F64:
    return np.asarray(xyz @ matrix[:3, :3].T + matrix[:3, 3])


@given(st.integers(0, 2**31), st.integers(0, 40))
def test_each_cell_has_its_nearest_point(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    matrices, xyz = two_cameras(random).astype(np.float32), random.uniform(-5, 5, (count, 3)).astype(np.float32)
    found = nearest_in_cells(matrices, xyz, LOW.astype(np.float32), CELL.astype(np.float32), COLUMNS, ROWS, NEAR_M)
    expected: F32 = np.full((2, ROWS, COLUMNS), np.inf, np.float32)
    for camera in range(2):
        for point in moved(matrices[camera].astype(np.float64), xyz.astype(np.float64)):
            column, row = (point[:2] / point[2] - LOW[camera]) / CELL[camera]
            if point[2] > NEAR_M and 0 <= column < COLUMNS and 0 <= row < ROWS:
                cell = camera, int(row), int(column)
                expected[cell] = min(expected[cell], np.float32(np.linalg.norm(point)))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@given(st.integers(0, 2**31))
def test_shares_of_the_cells_that_objects_fill(seed: int) -> None:
    random = np.random.default_rng(seed)
    nearest = random.uniform(2, 12, (2, ROWS, COLUMNS)).astype(np.float32)
    nearest[random.uniform(size=nearest.shape) < 0.3] = np.inf
    matrices, count = two_cameras(random), 5
    centers, sizes = random.uniform([-4, -4, -9], [4, 4, 9], (count, 3)), random.uniform(0.01, 3, (count, 3))
    corners = box_corners(centers, sizes, random.uniform(-3, 3, count))
    cameras, objects = random.integers(2, size=9), random.integers(count, size=9)
    found = nearer_shares(nearest, matrices, corners, cameras, objects, LOW, CELL, NEAR_M, 0.97, 1.0)
    for share, camera, row in zip(found, cameras, objects, strict=True):
        seen = moved(matrices[camera], corners[row])
        places = (seen[:, :2] / np.maximum(seen[:, 2:], NEAR_M) - LOW[camera]) / CELL[camera]
        counts = np.array([COLUMNS, ROWS])
        first = np.clip(np.floor(places.min(0)), -1, counts)
        last = np.maximum(np.clip(np.ceil(places.max(0)), 0, counts + 1), first + 1)
        (left, top), (right, bottom) = np.maximum(first, 0).astype(int), last.astype(int)
        cells = nearest[camera, top:bottom, left:right]
        middle = seen.mean(0)
        near_side = np.linalg.norm(middle) - np.linalg.norm(seen - middle, axis=1).max()
        assert share == np.sum(cells < 0.97 * near_side) / (np.isfinite(cells).sum() + 1)
