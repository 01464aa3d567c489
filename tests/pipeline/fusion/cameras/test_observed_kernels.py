"""What 2D boxes say of directions, in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.cameras.observed_kernels import extents_seen, hidden_edges

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.geometry.boxes import wrap_angle

EDGE_SHARE, NEARER_SHARE = 0.3, 0.05


def judged_hidden(cameras: I64, xyxy: F64) -> Bools:
    hidden = np.zeros((len(cameras), 4), np.bool_)
    for camera in np.unique(cameras):
        rows = np.flatnonzero(cameras == camera)
        left, top, right, bottom = xyxy[rows].T
        width, height = (right - left)[:, None], (bottom - top)[:, None]
        across = np.minimum(right[:, None], right) - np.maximum(left[:, None], left) >= EDGE_SHARE * width
        along = np.minimum(bottom[:, None], bottom) - np.maximum(top[:, None], top) >= EDGE_SHARE * height
        margin = NEARER_SHARE * width
        nearer = bottom > bottom[:, None] + NEARER_SHARE * height
        on_left = along & (left < left[:, None] - margin) & (right > left[:, None] - margin)
        on_right = along & (right > right[:, None] + margin) & (left < right[:, None] + margin)
        below = across & (top < bottom[:, None])
        hidden[rows] = (np.stack([on_left, np.zeros_like(below), on_right, below], -1) & nearer[..., None]).any(1)
    return hidden


@pytest.mark.parametrize("count", [0, 1, 60])
def test_hidden_edges(count: int) -> None:
    random = np.random.default_rng(count)
    cameras, low = np.sort(random.integers(0, 3, count)), random.integers(0, 12, (count, 2))
    xyxy = np.concatenate([low, low + random.integers(1, 12, (count, 2))], 1).astype(np.float64)
    found = hidden_edges(cameras, xyxy, EDGE_SHARE, NEARER_SHARE)
    np.testing.assert_array_equal(found, judged_hidden(cameras, xyxy))
    assert count < 60 or found[:, [0, 2, 3]].any(0).all()


@pytest.mark.parametrize("count", [0, 1, 30])
def test_extents(count: int) -> None:
    random = np.random.default_rng(count)
    rays, low = random.normal(size=(count, 8, 3)), random.uniform(0, 400, (count, 2))
    xyxy = np.concatenate([low, low + random.uniform(1, 200, (count, 2))], 1)
    cut, hidden = random.random((count, 4)) < 0.3, random.random((count, 4)) < 0.3
    run, bearing = np.hypot(rays[..., 0], rays[..., 1]), np.arctan2(rays[..., 1], rays[..., 0])
    found = extents_seen(rays, run, bearing, xyxy, cut, hidden, np.array([2.25, 9e-4, 100.0, 0.0625]))

    slope = rays[..., 2] / run
    width, lower, upper = wrap_angle(bearing[:, 7] - bearing[:, 3]), slope[:, 5], slope[:, 1]
    extent_px = np.tile(xyxy[:, 2:] - xyxy[:, :2], 2)
    variance = (2.25 + 9e-4 * (extent_px[:, 0] * extent_px[:, 1])[:, None]) / extent_px**2
    variance += np.where(cut, 100.0, np.where(hidden, 0.0625, 0.0))
    extent = np.stack([np.abs(width), np.abs(upper - lower)] * 2, 1)
    for one, other in zip(found, (bearing[:, 7], width, lower, upper, extent * np.sqrt(variance)), strict=True):
        np.testing.assert_array_equal(one, other)
