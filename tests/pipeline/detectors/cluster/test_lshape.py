import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.detectors.cluster.lshape import (
    fit_rectangles,
    principal_axes,
    quantiles_by_cluster,
    rectangles_along,
)

ONE = np.array([0])


def corner(angle: float, *, noise_m: float = 0.01) -> F64:
    """Two sides of a rectangle that meet at (5, 3)."""
    along, across = np.linspace(0, 4.0, 80), np.linspace(0, 1.7, 40)
    points = np.concatenate([np.stack([along, 0 * along], 1), np.stack([0 * across, across], 1)])
    points += noise_m * np.random.default_rng(0).standard_normal(points.shape)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(points @ turn + (5.0, 3.0))


def off_deg(found: float, true: float) -> float:
    """Difference of two headings of a rectangle, whose axes may change places."""
    off = np.rad2deg(found - true) % 90
    return float(min(off, 90 - off))


@given(angle=st.floats(-4.0, 4.0))
@settings(derandomize=True)
def test_corner_at_any_heading(angle: float) -> None:
    rectangles = fit_rectangles(corner(angle), ONE)
    assert off_deg(rectangles.angle_rad[0], angle) <= 1.0
    assert 0 <= rectangles.angle_rad[0] < np.pi / 2
    assert sorted((rectangles.high - rectangles.low)[0]) == pytest.approx([1.7, 4.0], abs=0.1)
    assert rectangles.residual_m[0] < 0.06


def test_middle_of_the_rectangle_and_stray_points() -> None:
    rectangles = fit_rectangles(corner(0.3), ONE)
    middle = (rectangles.low + rectangles.high)[0] / 2 @ rotations_2d(-rectangles.angle_rad)[0]
    true = np.array([5.0, 3.0]) + np.array([[2.0, 0.85]]) @ [[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]
    assert middle == pytest.approx(true[0], abs=0.05)
    stray = np.array([[4.0, 2.5], [9.5, 3.0]])
    assert off_deg(fit_rectangles(np.concatenate([corner(0.0), stray]), ONE).angle_rad[0], 0.0) <= 1.0


def test_many_clusters_are_fitted_as_each_alone() -> None:
    clusters = [corner(angle) for angle in (0.1, 0.7, 1.4)]
    starts = np.array([0, 120, 240])
    together = fit_rectangles(np.concatenate(clusters), starts)
    alone = [fit_rectangles(cluster, ONE) for cluster in clusters]
    for name in ("angle_rad", "low", "high", "residual_m"):
        np.testing.assert_allclose(getattr(together, name), np.concatenate([getattr(one, name) for one in alone]))


@pytest.mark.parametrize(
    "xy",
    [
        pytest.param(np.array([[1.0, 2.0]]), id="one point"),
        pytest.param(np.tile([[1.0, 2.0]], (20, 1)), id="all in one place"),
        pytest.param(np.linspace([0, 0], [3, 1], 50), id="line"),
    ],
)
def test_shapes_without_area(xy: F64) -> None:
    rectangles = fit_rectangles(xy, ONE)
    extent = np.sort(rectangles.high - rectangles.low)[0]
    assert extent == pytest.approx([0.0, np.linalg.norm(np.ptp(xy, axis=0))], abs=0.02)


def some_clusters(seed: int) -> tuple[F64, I64]:
    """Up to 30 clusters of 1 to 3000 points, some of them lines, corners, and points that come several times."""
    rng = np.random.default_rng(seed)
    clusters = []
    for _ in range(rng.integers(1, 30)):
        count = int(np.exp(rng.uniform(0, rng.choice([3.0, 8.0]))))
        shape = [
            rng.uniform(0, 4, (count, 2)),
            corner(rng.uniform(0, 3), noise_m=0.03)[rng.integers(0, 120, count)],
            np.round(rng.uniform(0, 2, (count, 2))),
            np.linspace([0, 0], rng.uniform(-3, 3, 2), count),
        ][rng.integers(0, 4)]
        clusters.append(shape + rng.choice([0.0, 40.0]))
    return np.concatenate(clusters), np.cumsum([0, *map(len, clusters)])[:-1]


@pytest.mark.parametrize("seed", range(4))
def test_quantiles_and_rectangles_of_each_cluster_alone(seed: int) -> None:
    xy, starts = some_clusters(seed)
    angles = np.random.default_rng(seed).uniform(0, np.pi / 2, len(starts))
    found = rectangles_along(xy, starts, angles)
    for share in (0.0, 0.01, 0.3, 0.5, 0.99, 1.0):
        ordered = [np.sort(part) for part in np.split(xy[:, 0], starts[1:])]
        outwards = np.floor if share < 0.5 else np.ceil
        expected = [part[int(outwards(share * (len(part) - 1)))] for part in ordered]
        np.testing.assert_array_equal(quantiles_by_cluster(xy[:, 0], starts, share), expected)
    for row, (part, turn) in enumerate(zip(np.split(xy, starts[1:]), rotations_2d(-angles), strict=True)):
        along = part @ turn.T
        low, high = np.quantile(along, 0.01, axis=0, method="lower"), np.quantile(along, 0.99, axis=0, method="higher")
        to_side = np.minimum(np.abs(along - low), np.abs(along - high)).min(1)
        np.testing.assert_allclose(found.low[row], low, atol=1e-9)
        np.testing.assert_allclose(found.high[row], high, atol=1e-9)
        np.testing.assert_allclose(found.residual_m[row], np.sqrt((to_side**2).mean()), atol=1e-9)


def turned_about(xy: F64, angle: float) -> F64:
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
    found, roundness = principal_axes(turned_about(ellipse, angle) + np.array([5.0, -3.0]), ONE)
    assert found == pytest.approx([angle], abs=0.02)
    assert roundness == pytest.approx([0.5], abs=0.02)


def test_a_rider_is_along_its_axis_and_not_along_the_rectangle() -> None:
    by_axis, by_rectangle = [], []
    for seed in range(20):
        points = turned_about(rider(seed), 0.6)
        by_axis.append(principal_axes(points, ONE)[0][0] - 0.6)
        by_rectangle.append((fit_rectangles(points, ONE).angle_rad[0] - 0.6 + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    assert np.median(np.abs(by_axis)) < np.deg2rad(4)
    assert np.median(np.abs(by_rectangle)) > np.deg2rad(8)


def test_lines_and_single_points() -> None:
    line = np.array([[0.0, 0], [1, 1], [2, 2]])
    found, roundness = principal_axes(np.concatenate([[[4.0, 4.0]], line, [[1.0, 1], [1, 1]]]), np.array([0, 1, 4]))
    assert found[1] == pytest.approx(np.pi / 4)
    assert roundness.tolist() == pytest.approx([1, 0, 1], abs=1e-6)
    assert np.isfinite(found).all()
