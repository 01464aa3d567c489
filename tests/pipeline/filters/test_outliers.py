from collections.abc import Callable

import numpy as np
import pytest
from helpers import oracle_cloud, shared
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.filters.outliers import neighbor_distance_m, points_in_air, statistical_inliers
from lidcam.pipeline.native.kernels import mean_neighbor_distance_m

SCENES = ("odd_cloud2_small", "odd_dups", "odd_nan", "odd_tiny", "s10k_0", "s10k_1", "s30k_0")


@pytest.mark.parametrize("scene", SCENES)
def test_keeps_exactly_what_pcl_keeps(scene: str) -> None:
    cloud, _ = oracle_cloud(scene)
    finite = np.flatnonzero(np.isfinite(cloud).all(axis=1))
    kept_by_pcl = np.fromfile(shared(f"oracles/combiner/{scene}/sor_kept.bin"), "<i4")

    kept = finite[statistical_inliers(neighbor_distance_m(cloud[finite]), std_ratio=0.2)]

    # PCL keeps every point that is not finite; lidcam's clouds have none.
    np.testing.assert_array_equal(kept, np.intersect1d(kept_by_pcl, finite))
    assert len(np.setdiff1d(kept_by_pcl, finite)) == len(cloud) - len(finite)


@pytest.mark.parametrize(
    "xyz",
    [
        *(np.arange(3.0 * count).reshape(count, 3) ** 3 for count in (0, 1, 2, 10)),
        np.repeat([[1.0, 2, 3], [7, 8, 9]], 12, axis=0),
        np.full((50_000, 3), 3.0),
    ],
    ids=["none", "one", "two", "too few", "duplicates", "one place"],
)
def test_clouds_that_are_kept_whole(xyz: F64) -> None:
    assert statistical_inliers(neighbor_distance_m(xyz.astype(np.float32)), std_ratio=0.0).all()


@pytest.mark.parametrize(("drops", "share"), [(0, 0.0), (100, 0.0), (600, 0.8)], ids=["clear", "a few", "snow"])
def test_points_in_the_air(drops: int, share: float) -> None:
    rng = np.random.default_rng(1)
    ground = rng.uniform((-12, -12, -1.7), (12, 12, -1.7), (120_000, 3))
    car = rng.uniform((4, -1, -1.7), (4, 1, 0), (2000, 3))
    person_far_away = rng.uniform((40, 0, -1.7), (40, 0.5, 0), (12, 3))
    snow = rng.uniform((-6, -6, -1), (3, 6, 2), (drops, 3))
    xyz = np.concatenate([ground, car, person_far_away, snow]).astype(np.float32)
    range_m = np.linalg.norm(xyz, axis=1)
    found = points_in_air(neighbor_distance_m(xyz), range_m, np.zeros(len(xyz), np.uint8))
    assert found[len(xyz) - drops :].sum() >= share * drops
    assert found[: len(xyz) - drops].sum() <= 0.001 * len(xyz) * (share > 0)


# --- the mean distances themselves


def judged(xyz: F32, neighbors: int) -> F32:
    """Of the nearest by scipy's tree in float64, and some more, with PCL's rounding."""
    points = xyz.astype(np.float64)
    _, rows = cKDTree(points).query(points, k=min(neighbors + 9, len(xyz)))
    x, y, z = np.moveaxis(xyz[:, None] - xyz[rows], -1, 0)
    with np.errstate(over="ignore"):
        squares = np.minimum((x * x + y * y) + z * z, np.finfo(np.float32).max)
    nearest = np.sqrt(np.sort(squares, axis=1)[:, 1 : neighbors + 1])
    total = np.zeros(len(xyz))
    for distance in nearest.T:
        total += distance
    return (total / neighbors).astype(np.float32)


def clustered(rng: np.random.Generator, count: int) -> F64:
    middles = rng.uniform(-50, 50, (1 + count // 100, 3))
    return middles[rng.integers(len(middles), size=count)] + rng.normal(size=(count, 3))


CLOUDS: dict[str, Callable[[np.random.Generator], F64]] = {
    "ball": lambda rng: rng.normal(size=(3000, 3)),
    "clusters": lambda rng: clustered(rng, 3000),
    "flat": lambda rng: np.column_stack([rng.uniform(-40, 40, (3000, 2)), np.zeros(3000)]),
    "line": lambda rng: np.column_stack([rng.uniform(-40, 40, 3000), np.zeros((3000, 2))]),
    "grid": lambda rng: np.stack(np.meshgrid(*[np.arange(14.0)] * 3), -1).reshape(-1, 3)[rng.permutation(14**3)],
    "equal points": lambda rng: rng.integers(0, 3, (3000, 3)).astype(float),
    "one far away": lambda rng: np.concatenate([rng.normal(size=(2999, 3)), [[1e9, 0, 0]]]),
    "all scales": lambda rng: rng.normal(size=(3000, 3)) * 10.0 ** rng.uniform(-6, 6, (3000, 1)),
    "far from the origin": lambda rng: rng.normal(size=(3000, 3)) + np.array([5e5, 5.8e6, 100]),
    "squares beyond float32": lambda rng: rng.normal(size=(3000, 3)) * 1e20,
    "just more than a run": lambda rng: rng.normal(size=(17, 3)),
    "just more than a node": lambda rng: rng.normal(size=(257, 3)),
}


@pytest.mark.parametrize("neighbors", [1, 10, 16])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_mean_distances_are_exact(cloud: str, neighbors: int) -> None:
    xyz = CLOUDS[cloud](np.random.default_rng(5)).astype(np.float32)
    np.testing.assert_array_equal(mean_neighbor_distance_m(xyz, neighbors), judged(xyz, neighbors))


@given(
    xyz=st.integers(2, 60).flatmap(lambda n: arrays(np.float32, (n, 3), elements=st.floats(-5, 5, width=16))),
    share=st.floats(0, 1),
)
def test_mean_distances_of_any_cloud(xyz: F32, share: float) -> None:
    neighbors = 1 + round(share * (len(xyz) - 2))
    np.testing.assert_array_equal(mean_neighbor_distance_m(xyz, neighbors), judged(xyz, neighbors))
