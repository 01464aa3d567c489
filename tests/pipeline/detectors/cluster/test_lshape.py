import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lshape_judge import judged_quantiles, judged_rectangles

from pipeline.core.arrays import F64, I64
from pipeline.detectors.cluster.lshape import fit_rectangles, quantiles_by_cluster


def corner(angle: float, *, length: float = 4.0, width: float = 1.7, noise_m: float = 0.01) -> F64:
    """Two sides of a rectangle that meet at (5, 3)."""
    along, across = np.linspace(0, length, 80), np.linspace(0, width, 40)
    points = np.concatenate([np.stack([along, 0 * along], 1), np.stack([0 * across, across], 1)])
    points += noise_m * np.random.default_rng(0).standard_normal(points.shape)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(points @ turn + (5.0, 3.0))


def off_deg(found: float, true: float) -> float:
    """Difference of two headings of a rectangle, whose axes may change places."""
    off = np.rad2deg(found - true) % 90
    return float(min(off, 90 - off))


@given(angle=st.floats(-4.0, 4.0))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_corner_at_any_heading(angle: float) -> None:
    rectangles = fit_rectangles(corner(angle), np.array([0]))
    assert off_deg(rectangles.angle_rad[0], angle) <= 1.0
    assert 0 <= rectangles.angle_rad[0] < np.pi / 2
    assert sorted((rectangles.high - rectangles.low)[0]) == pytest.approx([1.7, 4.0], abs=0.1)
    assert rectangles.residual_m[0] < 0.06


def test_middle_of_the_rectangle_in_the_frame_of_the_points() -> None:
    rectangles = fit_rectangles(corner(0.3), np.array([0]))
    middle = (rectangles.low + rectangles.high)[0] / 2 @ rectangles.axes[0]
    true = np.array([5.0, 3.0]) + np.array([[2.0, 0.85]]) @ [[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]
    assert middle == pytest.approx(true[0], abs=0.05)


def test_stray_points_do_not_turn_it() -> None:
    stray = np.array([[4.0, 2.5], [9.5, 3.0]])
    rectangles = fit_rectangles(np.concatenate([corner(0.0), stray]), np.array([0]))
    assert off_deg(rectangles.angle_rad[0], 0.0) <= 1.0


def test_many_clusters_are_fitted_as_each_alone() -> None:
    clusters = [corner(angle) for angle in (0.1, 0.7, 1.4)]
    starts = np.array([0, 120, 240])
    together = fit_rectangles(np.concatenate(clusters), starts)
    alone = [fit_rectangles(cluster, np.array([0])) for cluster in clusters]
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
    rectangles = fit_rectangles(xy, np.array([0]))
    extent = np.sort(rectangles.high - rectangles.low)[0]
    assert extent == pytest.approx([0.0, np.linalg.norm(np.ptp(xy, axis=0))], abs=0.02)


def test_quantiles_keep_the_ends_of_small_clusters_and_cut_those_of_large_ones() -> None:
    small, large = np.array([3.0, 1.0, 2.0]), np.random.default_rng(0).permutation(np.arange(1001.0))
    values, starts = np.concatenate([small, large]), np.array([0, 3])
    low, high = (quantiles_by_cluster(values, starts, share) for share in (0.01, 0.99))
    assert low.tolist() == pytest.approx([1.0, 10.0])
    assert high.tolist() == pytest.approx([3.0, 990.0])


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
        clusters.append(shape + rng.choice([0.0, 40.0, 1e6]))
    return np.concatenate(clusters), np.cumsum([0, *map(len, clusters)])[:-1]


@pytest.mark.parametrize("seed", range(25))
def test_same_as_by_array_operations(seed: int) -> None:
    xy, starts = some_clusters(seed)
    found, judged = fit_rectangles(xy, starts), judged_rectangles(xy, starts)
    for name in ("angle_rad", "low", "high", "residual_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(judged, name), err_msg=name)
    for share in (0.0, 0.01, 0.3, 0.5, 0.99, 1.0):
        np.testing.assert_array_equal(
            quantiles_by_cluster(xy[:, 0], starts, share), judged_quantiles(xy[:, 0], starts, share)
        )
