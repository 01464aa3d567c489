"""Boxes in images in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.matching.in_view_kernels import clipped_edges, in_pyramids, seen_from


@pytest.mark.parametrize(("cameras", "boxes"), [(0, 4), (3, 0), (3, 50)])
def test_points_and_spheres_in_the_views_of_cameras(cameras: int, boxes: int) -> None:
    random = np.random.default_rng(boxes)
    points, radii_m = random.normal(0, 20, (boxes, 3)), random.uniform(0.3, 6, boxes)
    rotations, translations = random.normal(size=(cameras, 3, 3)), random.normal(size=(cameras, 3))
    centers = seen_from(points, rotations, translations)
    expected = np.einsum("cij,nj->cni", rotations, points) + translations[:, None]
    np.testing.assert_allclose(centers, expected, rtol=1e-12, atol=1e-12)

    planes = random.normal(size=(cameras, 4, 3))
    lengths = np.linalg.norm(planes, axis=2)
    inside = np.einsum("cbi,cni->cbn", planes, centers) > -lengths[..., None] * radii_m
    found = in_pyramids(centers, radii_m, planes, lengths, 0.01)
    np.testing.assert_array_equal(found, (centers[..., 2] + radii_m > 0.01) & inside.all(1))
    assert boxes * cameras == 0 or 0 < found.sum() < found.size


@pytest.mark.parametrize("count", [0, 1, 40])
def test_rectangles_clipped_to_their_images(count: int) -> None:
    random = np.random.default_rng(count)
    sizes, cameras = np.array([[640.0, 480.0], [100.0, 900.0]]), random.integers(0, 2, count)
    edges, jacobian = random.uniform(-300, 1000, (count, 4)), random.normal(size=(count, 4, 7))
    valid = random.random(count) < 0.7
    xyxy, slopes, cut = clipped_edges(edges, jacobian, valid, cameras, sizes)
    expected = np.clip(edges, 0.0, np.tile(sizes[cameras], 2))
    np.testing.assert_array_equal(xyxy, expected)
    moves = ((edges == expected) & valid[:, None])[..., None]
    np.testing.assert_array_equal(slopes, np.where(moves, jacobian[..., :3], 0.0))
    np.testing.assert_array_equal(cut, np.flatnonzero(~valid))
