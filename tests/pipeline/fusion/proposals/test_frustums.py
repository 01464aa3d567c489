from typing import Any

import numpy as np
import pytest
from detections import boxes2d
from hypothesis import given
from hypothesis import strategies as st
from seen_boxes import camera_at, views_of

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.fusion.cameras.sightings import Sightings, see
from lidcam.pipeline.fusion.proposals.frustums import (
    SIDE_MARGIN,
    Expected,
    FrustumPoints,
    Segments,
    choose_segments,
    points_in_frustums,
)

CAMERA = camera_at("cam", (1.0, -2.0, 4.0), yaw_deg=30, pitch_deg=12)
ROWS = [(100.0, 200, 500, 600, 0.9, 0), (480.0, 100, 900, 300, 0.8, 0)]


def seen(*rows: tuple[float, ...]) -> Sightings:
    return see(views_of(CAMERA), {"cam": boxes2d(rows)})


def inside(xyz: np.ndarray, sightings: Sightings, near: float = 0.0, far: float = 1e3) -> FrustumPoints:
    n = len(sightings)
    return points_in_frustums(xyz.astype(np.float32), sightings, np.full(n, near), np.full(n, far))


@pytest.mark.parametrize("count", [0, 1, 5000])
@given(seed=st.integers(0, 99))
def test_points_are_those_projected_into_the_box(count: int, seed: int) -> None:
    xyz = np.random.default_rng(seed).normal(size=(count, 3)) * [30, 30, 3]
    sightings = seen(*ROWS)
    found = inside(xyz, sightings)
    pixels, valid = CAMERA.model.project(CAMERA.T_camera_site.apply(xyz))
    for row, (left, top, right, bottom, *_) in enumerate(ROWS):
        margin = SIDE_MARGIN * (right - left)
        u, v = pixels.T
        expected = valid & (u > left + margin) & (u < right - margin) & (v > top) & (v < bottom)
        off = np.setxor1d(found.rows[found.group == row], np.flatnonzero(expected))
        edges = np.abs(pixels[off] - np.clip(pixels[off], [left + margin, top], [right - margin, bottom])).max(
            initial=0
        )
        assert edges < 0.01
        assert len(off) <= 1, "but for rounding"


def test_points_are_told_where_they_lie_in_the_box() -> None:
    sightings = seen((200.0, 100, 600, 500, 0.9, 0))
    pixels = np.array([[212.0, 100], [400, 300], [588, 500], [306, 180]])
    ahead = np.column_stack([(pixels - 0.5 - CAMERA.model.K[:2, 2]) / 900.0, np.ones(4)]) * 20
    found = inside(CAMERA.T_camera_site.inverse().apply(ahead * [0.999999, 0.999999, 1]), sightings)
    shares = np.column_stack([found.share_x, found.share_y])
    np.testing.assert_allclose(shares[found.rows == 1], [[0.5, 0.5]], atol=1e-3)
    np.testing.assert_allclose(shares[found.rows == 3], [[0.25, 0.2]], atol=1e-3)


def test_bent_sides_are_within_the_frustum() -> None:
    lens = camera_at("cam", (0.0, 0.0, 2.0), distortion=[-0.2, 0.03, 0.001, -0.001])
    sightings = see(views_of(lens), {"cam": boxes2d([(60, 80, 400, 500, 0.9, 0)])})
    grid = np.stack(np.meshgrid(np.linspace(80, 380, 20), np.linspace(82, 498, 20)), -1).reshape(1, -1, 2)
    rays = np.concatenate([(grid[0] - 0.5 - lens.model.K[:2, 2]) / 900, np.ones((400, 1))], 1)
    for _ in range(50):  # the rays of these pixels, by steps of what is missing
        rays[:, :2] += (grid[0] - lens.model.project(rays)[0]) / 900
    found = inside(lens.T_camera_site.inverse().apply(15 * rays), sightings)
    assert len(found) == 400


def wall(x: float, *, low: float, high: float, count: int = 40, top: float = 1.5) -> F64:
    """Points of a surface across the view, 10 m wide in all: `low` and `high` are shares of that."""
    y, z = np.meshgrid(np.linspace(low, high, count) * 10, np.linspace(0.3, top, 4))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


def choose(
    *frustums: list[F64], front_m: float = 10.0, std_m: float = 1.0, min_points: int = 4, gap: float = 0.0
) -> Segments:
    """What is chosen in frustums whose box is 10 m wide and 1.5 m high."""
    clouds = [np.concatenate([np.zeros((0, 3)), *parts]) for parts in frustums]
    xyz = np.concatenate([np.zeros((0, 3)), *clouds])
    group = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    found = FrustumPoints(
        np.arange(len(xyz)), group, xyz[:, 1] / 10, 1 - xyz[:, 2] / 1.5, np.ascontiguousarray(xyz[:, 0])
    )
    n = len(clouds)
    expected = Expected(np.full(n, front_m), np.full(n, std_m), np.full(n, 5.0), np.full(n, 0.2), np.full(n, gap))
    return choose_segments(xyz.astype(np.float32), found, np.full(len(xyz), 0.6), expected, min_points)


def rows(segments: Segments) -> list[list[int]]:
    return [sorted(part.tolist()) for part in np.split(segments.points, segments.starts[1:])][: len(segments.group)]


OBJECT = wall(10.0, low=0.1, high=0.9)
LINE = OBJECT[:40]
"""Of a single beam."""
FOUR = np.array([[10.0, 2.0 + 0.27 * k, 0.5 * k] for k in range(4)])


@pytest.mark.parametrize(
    ("cloud", "count", "settings"),
    [
        pytest.param(OBJECT, 1, {}, id="an object"),
        pytest.param(wall(20.0, low=0.0, high=1.0), 0, {}, id="not where it should be"),
        pytest.param(wall(20.0, low=0.0, high=1.0), 1, {"std_m": 4.0}, id="nor known well"),
        pytest.param(wall(10.0, low=0.4, high=0.6), 0, {}, id="a strip of the box"),
        pytest.param(LINE, 0, {}, id="one beam"),
        pytest.param(LINE, 1, {"gap": 0.3}, id="one beam where beams are far apart"),
        pytest.param(LINE[:5], 0, {"gap": 0.3}, id="not as wide as the 2D box"),
        pytest.param(FOUR, 0, {"min_points": 5}, id="few points are noise"),
    ],
)
def test_which_segment_is_an_object(cloud: F64, count: int, settings: Any) -> None:
    assert len(choose([cloud], **settings).group) == count


def test_long_segments_end_where_the_class_does() -> None:
    x = np.arange(9.0, 30.0, 0.2)
    hedge = np.column_stack([x, 5 + 0 * x, np.tile([0.4, 0.9, 1.4], 35)[: len(x)]])
    cloud = np.concatenate([wall(9.0, low=0.1, high=0.9), hedge])
    assert cloud[choose([cloud]).points, 0].max() <= 9.0 + 5.0 + 1e-6


def test_each_frustum_has_its_own() -> None:
    shifted, behind = OBJECT + np.array([0.5, 0, 0]), OBJECT + np.array([3.0, 0, 0])
    found = choose([OBJECT], [], [shifted, behind])
    assert found.group.tolist() == [0, 2]
    assert rows(found) == [list(range(len(OBJECT))), list(range(len(OBJECT), 2 * len(OBJECT)))]
    assert (found.worth <= 0).all()
