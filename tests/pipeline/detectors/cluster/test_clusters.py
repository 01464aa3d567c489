"""Points averaged by cells, and linked; judged by scipy, and by distances of all pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, pdist

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.detectors.cluster.clusters import LINK_CELL_SHARE, cluster_points, thin_points


def line(*x: float) -> F64:
    return np.array([[value, 0.0, 0.0] for value in x])


def groups(labels: I64) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in np.unique(labels)}


@pytest.mark.parametrize(
    ("points", "distance_m", "expected"),
    [
        pytest.param(np.zeros((0, 3)), [], set(), id="empty"),
        pytest.param(line(3.0), [1.0], {frozenset({0})}, id="one"),
        pytest.param(line(0.0, 0.9), [1.0, 1.0], {frozenset({0, 1})}, id="near"),
        pytest.param(line(0.0, 1.1), [1.0, 1.0], {frozenset({0}), frozenset({1})}, id="apart"),
        pytest.param(line(0.0, 0.9, 1.8, 2.7), [1.0] * 4, {frozenset({0, 1, 2, 3})}, id="chain"),
        pytest.param(line(0.0, 0.9), [1.0, 0.5], {frozenset({0}), frozenset({1})}, id="the smaller distance counts"),
        pytest.param(line(0.0, 1.9, 100.0, 101.9), [1.0, 1.0, 2.0, 2.0], None, id="distance grows"),
    ],
)
def test_clusters_of_a_few_points(points: F64, distance_m: list[float], expected: set[frozenset[int]] | None) -> None:
    count, labels = cluster_points(points, np.array(distance_m))
    expected = {frozenset({0}), frozenset({1}), frozenset({2, 3})} if expected is None else expected
    assert groups(labels) == expected
    assert count == len(expected)


@given(points=arrays(np.int64, st.tuples(st.integers(2, 40), st.just(3)), elements=st.integers(-6, 6)))
@settings(derandomize=True)
def test_clusters_are_those_of_single_linkage(points: I64) -> None:
    # Whole numbers and a distance of 1.2 keep every point in a cell of its own, so that scipy judges the same problem.
    exact = points.astype(np.float64)
    _, labels = cluster_points(exact, np.full(len(exact), 1.2))
    judged = fcluster(linkage(pdist(exact), "single"), 1.2, "distance")
    assert groups(labels) == groups(np.asarray(judged, np.int64))


@pytest.mark.parametrize("seed", range(6))
def test_cells_are_linked_up_to_the_smaller_of_their_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 400))
    points = rng.uniform(-1, 1, (count, 3)) * 10.0 ** rng.integers(-1, 4)
    points = points[rng.integers(0, count, count)] if seed % 2 else points
    points += rng.choice([0.0, 1e3, 1e6])
    distance_m = 0.5 + rng.random() * np.abs(points[:, 0] - points[0, 0]) * rng.choice([0.0, 0.02, 1.0])
    cells = thin_points(points, distance_m, LINK_CELL_SHARE)
    near = cdist(cells.means, cells.means) <= np.minimum(cells.distance_m, cells.distance_m[:, None])
    expected, of_cell = connected_components(near)
    found, labels = cluster_points(points, distance_m)
    assert found == expected
    assert groups(labels) == groups(of_cell[cells.cell_of_point].astype(np.int64))


@pytest.mark.parametrize("furthest_m", [1e9, 1e15, 1e30, 1e300])
def test_absurd_places_and_distances(furthest_m: float) -> None:
    """Places between which there are more cells than numbers may be taken for one; nothing worse happens."""
    points = np.array([[0.0, 0, 0], [0.3, 0, 0], [furthest_m, 0, 0], [-furthest_m, furthest_m, furthest_m]])
    for distance_m in (np.ones(4), np.array([1.0, 1.0, furthest_m, furthest_m])):
        count, labels = cluster_points(points, distance_m)
        assert labels[0] == labels[1]
        assert sorted(set(labels.tolist())) == list(range(count))
        assert count == 3 or furthest_m > 1e15


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, derandomize=True)
def test_order_of_points_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, distance = rng.uniform(-5, 5, (300, 3)), rng.uniform(0.2, 1.0, 300)
    order = rng.permutation(300)
    _, labels = cluster_points(points, distance)
    _, shuffled = cluster_points(points[order], distance[order])
    np.testing.assert_array_equal(shuffled, labels[order])
    cells, others = thin_points(points, distance, 1.0), thin_points(points[order], distance[order], 1.0)
    np.testing.assert_array_equal(cells.means, others.means)
    np.testing.assert_array_equal(cells.counts, others.counts)


def test_cells_hold_every_point_once_and_lie_within_their_size() -> None:
    rng = np.random.default_rng(1)
    points, group = rng.uniform(-20, 20, (5000, 3)), rng.integers(0, 3, 5000)
    cell_m = 0.3 + 0.1 * np.linalg.norm(points, axis=1)
    cells = thin_points(points, cell_m, 1.0, group)
    of_point = cells.cell_of_point
    np.testing.assert_array_equal(np.bincount(of_point), cells.counts)
    assert (np.abs(points - cells.means[of_point]) <= cell_m[:, None]).all()
    assert (cells.distance_m[of_point] <= cell_m).all()
    np.testing.assert_array_equal(of_point[cells.first], np.arange(len(cells.counts)))
    np.testing.assert_array_equal(group, group[cells.first][of_point])
