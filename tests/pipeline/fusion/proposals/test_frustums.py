import numpy as np
import pytest
from detections import boxes2d
from hypothesis import given
from hypothesis import strategies as st
from seen_boxes import camera_at, views_of

from pipeline.fusion.cameras.sightings import Sightings, see
from pipeline.fusion.proposals.frustums import SHRINK_SHARE, FrustumPoints, heading_of, points_in_frustums

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
        margin = SHRINK_SHARE * (right - left)
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


def test_only_between_the_distances() -> None:
    sightings = seen(ROWS[0])
    heading = heading_of(sightings)[0]
    middle = sightings.rays[0, [3, 7]].mean(0)
    along = np.array([5.0, 10.0, 20.0, 30.0])
    xyz = sightings.origin[0] + middle * (along / (middle[:2] @ heading))[:, None]
    found = inside(xyz, sightings, 8.0, 25.0)
    assert found.rows.tolist() == [1, 2]
    np.testing.assert_allclose(found.along_m, [10.0, 20.0], rtol=1e-5)


def test_bent_sides_are_within_the_frustum() -> None:
    lens = camera_at("cam", (0.0, 0.0, 2.0), distortion=[-0.2, 0.03, 0.001, -0.001])
    sightings = see(views_of(lens), {"cam": boxes2d([(60, 80, 400, 500, 0.9, 0)])})
    grid = np.stack(np.meshgrid(np.linspace(80, 380, 20), np.linspace(82, 498, 20)), -1).reshape(1, -1, 2)
    rays = np.concatenate([(grid[0] - 0.5 - lens.model.K[:2, 2]) / 900, np.ones((400, 1))], 1)
    for _ in range(50):  # the rays of these pixels, by steps of what is missing
        rays[:, :2] += (grid[0] - lens.model.project(rays)[0]) / 900
    found = inside(lens.T_camera_site.inverse().apply(15 * rays), sightings)
    assert len(found) == 400


def test_no_frustums() -> None:
    assert len(inside(np.ones((5, 3)), seen())) == 0
