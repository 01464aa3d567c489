import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.arrays import F64
from pipeline.core.geometry.boxes import rotations_2d
from pipeline.detectors.cluster.lshape import fit_rectangles
from pipeline.detectors.cluster.principal import principal_axes

ONE = np.array([0])


def turned(xy: F64, angle: float) -> F64:
    result: F64 = xy @ rotations_2d(np.array([angle]))[0].T
    return result


def rider(seed: int) -> F64:
    """Points of one side of a cyclist along x: wheels and frame in a line, a rider as wide as the handlebars."""
    random = np.random.default_rng(seed)
    bicycle = np.column_stack([random.uniform(-0.85, 0.85, 16), random.normal(0, 0.02, 16)])
    body = np.column_stack([random.uniform(-0.25, 0.3, 10), random.uniform(-0.25, 0.25, 10)])
    return np.concatenate([bicycle, body])


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5, -1.2])
def test_the_axis_is_that_of_the_points(angle: float) -> None:
    ellipse = np.column_stack([np.cos(np.arange(0, 6.28, 0.1)) * 2, np.sin(np.arange(0, 6.28, 0.1))])
    found, roundness = principal_axes(turned(ellipse, angle) + np.array([5.0, -3.0]), ONE)
    assert found == pytest.approx([angle], abs=0.02)
    assert roundness == pytest.approx([0.5], abs=0.02)


def test_a_rider_is_along_its_axis_and_not_along_the_rectangle() -> None:
    by_axis, by_rectangle = [], []
    for seed in range(20):
        points = turned(rider(seed), 0.6)
        by_axis.append(principal_axes(points, ONE)[0][0] - 0.6)
        by_rectangle.append((fit_rectangles(points, ONE).angle_rad[0] - 0.6 + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    assert np.median(np.abs(by_axis)) < np.deg2rad(4)
    assert np.median(np.abs(by_rectangle)) > np.deg2rad(8)


def test_same_as_by_array_operations() -> None:
    rng = np.random.default_rng(0)
    sizes = rng.integers(1, 700, 20)
    points, starts = rng.normal(20, 3, (sizes.sum(), 3)), np.cumsum(sizes) - sizes
    mean = np.add.reduceat(points[:, :2], starts) / sizes[:, None]
    x, y = (points[:, :2] - np.repeat(mean, sizes, axis=0)).T
    xx, xy, yy = (np.add.reduceat(product, starts) / sizes for product in (x * x, x * y, y * y))
    found, roundness = principal_axes(points, starts)
    np.testing.assert_array_equal(found, np.arctan2(2 * xy, xx - yy) / 2)
    apart = np.hypot((xx - yy) / 2, xy)
    least, most = np.maximum((xx + yy) / 2 - apart, 0.0), (xx + yy) / 2 + apart
    np.testing.assert_array_equal(roundness, np.sqrt(least / np.where(most > 0, most, 1)) + (most == 0))


def test_lines_and_single_points() -> None:
    line = np.array([[0.0, 0], [1, 1], [2, 2]])
    found, roundness = principal_axes(np.concatenate([[[4.0, 4.0]], line, [[1.0, 1], [1, 1]]]), np.array([0, 1, 4]))
    assert found[1] == pytest.approx(np.pi / 4)
    assert roundness.tolist() == pytest.approx([1, 0, 1], abs=1e-6)
    assert np.isfinite(found).all()


@given(st.integers(0, 1000), st.integers(1, 5))
def test_clusters_do_not_touch_each_other(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    clusters = [random.normal(0, 1, (int(random.integers(1, 9)), 2)) for _ in range(count)]
    starts = np.cumsum([0, *map(len, clusters)])[:-1]
    together = np.array(principal_axes(np.concatenate(clusters), starts))
    alone = np.concatenate([principal_axes(cluster, ONE) for cluster in clusters], axis=1)
    np.testing.assert_allclose(np.cos(2 * together[0]), np.cos(2 * alone[0]), atol=1e-6)
    np.testing.assert_allclose(together[1], alone[1], atol=1e-6)
