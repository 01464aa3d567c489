"""The ground where it is no plane: slopes, crests, kerbs, and what stands on it."""

from collections.abc import Callable

import numpy as np
import pytest

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import Plane, Relief
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.pipeline.filters.relief import find_relief

Heights = Callable[[F64], F64]
"""Z at points (N, 2)."""

CONFIG = GroundConfig()
FLAT = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
LIDAR = np.array([[0.0, 0.0, 1.8]])


def rings(heights: Heights, *, noise_m: float = 0.02, scale: float = 1.0) -> F32:
    """Points of 48 rings to 60 m on the ground; `scale` is that of a model of the site."""
    radius = np.repeat(1.8 / np.tan(np.deg2rad(np.linspace(24, 1.7, 48))), 720)
    azimuth = np.tile(np.linspace(0, 2 * np.pi, 720, endpoint=False), 48)
    xy = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth)])
    z = heights(xy) + np.random.default_rng(1).normal(0, noise_m, len(xy))
    return (np.column_stack([xy, z]) * scale).astype(np.float32)


def box(x: float, y: float, bottom_m: float, top_m: float, length: float = 4.0, width: float = 1.8) -> F32:
    """Points all over a box."""
    rng = np.random.default_rng(2)
    return rng.uniform((x, y, bottom_m), (x + length, y + width, top_m), (800, 3)).astype(np.float32)


def errors(relief: Relief, heights: Heights, *, within_m: float, scale: float = 1.0) -> F64:
    """Of the surface, on rings and between them."""
    rng = np.random.default_rng(3)
    radius, azimuth = rng.uniform(4, within_m, 4000), rng.uniform(-np.pi, np.pi, 4000)
    xy = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth)])
    return np.asarray(relief.offset_m(xy * scale) / scale - heights(xy))


@pytest.mark.parametrize(
    ("heights", "rms_m", "max_m"),
    [
        pytest.param(lambda xy: 0 * xy[:, 0], 0.02, 0.04, id="flat"),
        pytest.param(lambda xy: 0.05 * np.maximum(xy[:, 0] - 15, 0), 0.04, 0.2, id="slope up"),
        pytest.param(lambda xy: -0.05 * np.maximum(xy[:, 0] - 15, 0), 0.04, 0.2, id="slope down"),
        pytest.param(lambda xy: -0.0008 * xy[:, 0] ** 2, 0.04, 0.15, id="crest"),
        pytest.param(lambda xy: 0.14 * (np.abs(xy[:, 1]) > 5), 0.05, 0.14, id="kerbs"),
        pytest.param(lambda xy: 0.1 * np.sin(xy[:, 0] / 6) * np.cos(xy[:, 1] / 9), 0.04, 0.15, id="waves"),
    ],
)
@pytest.mark.parametrize("scale", [1.0, 0.07])
def test_the_surface_follows_the_ground(heights: Heights, rms_m: float, max_m: float, scale: float) -> None:
    config = GroundConfig(distance_m=0.2 * scale)
    relief = find_relief(rings(heights, scale=scale), LIDAR * scale, FLAT, config)
    off = errors(relief, heights, within_m=35.0, scale=scale)
    assert np.sqrt((off**2).mean()) <= rms_m
    assert np.abs(off).max() <= max_m


def test_what_stands_on_the_ground_does_not_lift_it() -> None:
    cars = [box(x, y, 0.25, 1.5) for x in (6.0, 12.0, 18.0) for y in (-4.0, 3.0)]
    wall = box(-20.0, 9.0, 0.4, 4.0, length=40.0, width=0.2)
    relief = find_relief(np.concatenate([rings(lambda xy: 0 * xy[:, 0]), *cars, wall]), LIDAR, FLAT, CONFIG)
    assert np.abs(errors(relief, lambda xy: 0 * xy[:, 0], within_m=35.0)).max() <= 0.1


def test_what_stands_where_no_ground_is_seen_does_not_lift_it() -> None:
    ground = rings(lambda xy: 0 * xy[:, 0])
    rears = [box(36.0, y, 0.3, 1.4, length=0.2) for y in np.arange(-12.0, 12.0, 3.0)]
    relief = find_relief(np.concatenate([ground[np.linalg.norm(ground, axis=1) < 28], *rears]), LIDAR, FLAT, CONFIG)
    assert np.abs(relief.offset_m(np.array([[37.0, y] for y in range(-12, 12)]))).max() <= 0.05


def test_a_tilted_plane_and_stray_points_below_it() -> None:
    normal = np.array([-0.06, 0.02, 1.0])
    plane = Plane(normal / np.linalg.norm(normal), 0.5)
    points = rings(plane.height_m)
    below = np.random.default_rng(4).uniform((-30, -30, -6), (30, 30, -3), (200, 3)).astype(np.float32)
    relief = find_relief(np.concatenate([points, below]), LIDAR, plane, CONFIG)
    assert np.abs(errors(relief, lambda xy: 0 * xy[:, 0], within_m=35.0)).max() <= 0.06


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[5.0, 0.0, 0.1]]), np.array([[5e5, -5e5, 0.0]])])
def test_few_or_far_points_leave_the_plane(points: F64) -> None:
    relief = find_relief(points.astype(np.float32), LIDAR, FLAT, CONFIG)
    assert np.isfinite(relief.offsets_m).all()
    assert np.abs(relief.offsets_m).max() <= 0.1


def test_the_order_of_the_points_does_not_matter_much_and_a_repeat_gives_the_same_bits() -> None:
    points = rings(lambda xy: 0.05 * np.maximum(xy[:, 0] - 15, 0))
    first, again = (find_relief(points, LIDAR, FLAT, CONFIG).offsets_m for _ in range(2))
    assert first.tobytes() == again.tobytes()
    shuffled = find_relief(np.random.default_rng(5).permutation(points), LIDAR, FLAT, CONFIG)
    np.testing.assert_allclose(shuffled.offsets_m, first, atol=1e-9)
