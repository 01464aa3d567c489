"""Passes over the edges of boxes, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.refining.edge_kernels import corners_in_cameras, doubted_edges, median_shifts, moved_edges

from pipeline.core.arrays import F64
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import UNIT_CORNERS, box_corners


@pytest.mark.parametrize("count", [0, 1, 20])
def test_corners(count: int) -> None:
    random = np.random.default_rng(count)
    centers, sizes, yaws = (
        random.normal(0, 9, (count, 3)),
        random.uniform(0.3, 9, (count, 3)),
        random.normal(size=count),
    )
    rotations, translations = random.normal(size=(count, 3, 3)), random.normal(size=(count, 3))
    found = corners_in_cameras(centers, sizes, np.cos(yaws), np.sin(yaws), UNIT_CORNERS, rotations, translations)
    expected = np.einsum("pij,pkj->pki", rotations, box_corners(centers, sizes, yaws)) + translations[:, None]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def extent_between(along: F64, other: F64, limit: F64) -> tuple[F64, F64]:
    """Least and largest `along` of boxes with corners (P, 8) where `other` is in [0, limit]."""
    first, last = BOX_EDGES.T
    a, b, c, d = along[:, first], along[:, last], other[:, first], other[:, last]
    rise = np.where(c == d, 1.0, d - c)
    places, reached = [along], [(other >= 0) & (other <= limit)]
    for border in (0.0, limit):
        crosses = (np.minimum(c, d) < border) & (np.maximum(c, d) > border)
        places.append(np.where(crosses, a + (b - a) * (border - c) / rise, 0.0))
        reached.append(crosses)
    place, is_there = np.concatenate(places, 1), np.concatenate(reached, 1)
    low, high = np.where(is_there, place, np.inf).min(1), np.where(is_there, place, -np.inf).max(1)
    none = ~is_there.any(1)
    return np.where(none, along.max(1), low), np.where(none, along.min(1), high)


@pytest.mark.parametrize("count", [0, 1, 80])
def test_edges_moved_by_borders(count: int) -> None:
    random = np.random.default_rng(count)
    middle, image_sizes = random.uniform(-300, 1000, (count, 1, 2)), random.uniform(200, 700, (count, 2))
    pixels = np.round(middle + random.normal(0, 150, (count, 8, 2)))  # some are level
    expected = np.empty((count, 4))
    for axis in (0, 1):
        along, other = pixels[..., axis], pixels[..., 1 - axis]
        low, high = extent_between(along, other, image_sizes[:, 1 - axis, None])
        expected[:, axis], expected[:, axis + 2] = low - along.min(1), along.max(1) - high
    np.testing.assert_array_equal(moved_edges(pixels, image_sizes, BOX_EDGES), np.maximum(expected, 0.0))


@pytest.mark.parametrize("count", [0, 1, 60])
def test_doubted_edges(count: int) -> None:
    random = np.random.default_rng(count)
    rows, image_sizes = random.integers(0, 9, count), random.uniform(200, 700, (count, 2))
    xyxy, predicted = random.uniform(0, 400, (count, 4)), random.uniform(0, 400, (count, 4))
    xyxy[::3, 0] = 0.0
    jacobian, root = random.normal(0, 9, (count, 4, 3)), random.normal(size=(9, 7, 7))
    sigma, cut, hidden = random.uniform(1, 9, (count, 4)), random.uniform(0, 9, (count, 4)), np.full((count, 4), 50.0)
    covariances = root @ root.transpose(0, 2, 1)
    found = doubted_edges(xyxy, predicted, jacobian, sigma, cut, hidden, rows, covariances, image_sizes, 2.5)

    own, C, away = np.sqrt(sigma**2 + cut**2), covariances[rows, :3, :3], xyxy - predicted
    expected_px = np.sqrt(np.einsum("pei,pij,pej->pe", jacobian, C, jacobian) + own**2)
    is_inside = away * [1, 1, -1, -1] > 2.5 * expected_px
    own = np.sqrt(own**2 + np.where(is_inside, hidden, 0.0) ** 2)
    slopes = (jacobian[:, :2] + jacobian[:, 2:]) / 2
    variances = np.einsum("pci,pij,pcj->pc", slopes, C, slopes) + (own[:, :2] ** 2 + own[:, 2:] ** 2) / 4
    whole = ((xyxy > 0) & (xyxy < np.tile(image_sizes, 2))).all(1)
    np.testing.assert_array_equal(found[1], whole)
    off = (away[:, :2] + away[:, 2:]) / 2
    for one, other in zip((found[0], *found[2:]), (own, off, variances), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10)
    assert count < 60 or (is_inside.any() and 0 < whole.sum() < count)


@pytest.mark.parametrize("count", [0, 1, 30, 31])
def test_shifts_of_cameras_are_medians(count: int) -> None:
    random = np.random.default_rng(count)
    cameras, residuals = random.integers(0, 4, count), random.normal(6, 4, (count, 2))
    variances = random.uniform(1, 30, (count, 2))
    found = median_shifts(cameras, residuals, variances, 5, 3.0, 1.2533)
    for camera in range(5):
        mine = cameras == camera
        if not mine.any():
            assert not found[camera].any()
            continue
        shift, sigma = np.median(residuals[mine], 0), 1.2533 * np.sqrt(np.median(variances[mine], 0) / mine.sum())
        np.testing.assert_allclose(found[camera], np.where(np.abs(shift) > 3 * sigma, shift, 0.0))
