import json
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers import shared
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.core.arrays import F32, F64
from pipeline.filters.outliers import statistical_inliers

SCENES = ("odd_cloud2_small", "odd_dups", "odd_nan", "odd_tiny", "s10k_0", "s10k_1", "s30k_0")


def oracle_cloud(scene: str) -> F32:
    """The combined cloud of the predecessor system: lidars shifted in float32, lidar11 before lidar12 and lidar2."""
    folder = shared(f"oracles/combiner/{scene}")
    offsets = json.loads((folder / "scene.json").read_text())["offsets"]
    names = ("lidar11", "lidar12", "lidar2")
    parts = [np.fromfile(folder / f"{name}.bin", "<f4").reshape(-1, 4)[:, :3] for name in names]
    shifted = [part + np.array(offset, np.float32) for part, offset in zip(parts, offsets, strict=True)]
    return np.concatenate(shifted)


def by_brute_force(xyz: F32, neighbors: int, std_ratio: float) -> F64:
    """The rule in float64, all pairs: 1 to keep, 0 to drop, NaN where rounding may decide."""
    points = xyz.astype(np.float64)
    distances = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)[:, 1 : neighbors + 1]
    mean = distances.mean(axis=1)
    margin: F64 = mean - (mean.mean() + std_ratio * mean.std(ddof=1))
    return np.where(np.abs(margin) < 1e-4 * (1 + mean), np.nan, (margin <= 0).astype(float))


@pytest.mark.parametrize("scene", SCENES)
def test_keeps_exactly_what_pcl_keeps(scene: str) -> None:
    cloud = oracle_cloud(scene)
    finite = np.flatnonzero(np.isfinite(cloud).all(axis=1))
    kept_by_pcl = np.fromfile(shared(f"oracles/combiner/{scene}/sor_kept.bin"), "<i4")

    kept = finite[statistical_inliers(cloud[finite], neighbors=10, std_ratio=0.2)]

    # PCL keeps every point that is not finite; lidcam's clouds have none.
    np.testing.assert_array_equal(kept, np.intersect1d(kept_by_pcl, finite))
    assert len(np.setdiff1d(kept_by_pcl, finite)) == len(cloud) - len(finite)


def test_one_stray_point_goes_and_the_grid_stays() -> None:
    grid = np.stack(np.meshgrid(range(5), range(5), range(5)), -1).reshape(-1, 3)
    xyz = np.concatenate([grid[:60], [[40, 40, 40]], grid[60:]]).astype(np.float32)
    keep = statistical_inliers(xyz, neighbors=10, std_ratio=1.0)
    assert np.flatnonzero(~keep).tolist() == [60]


@pytest.mark.parametrize("count", [0, 1, 2, 10])
def test_too_few_points_for_statistics_are_all_kept(count: int) -> None:
    xyz = np.arange(3 * count, dtype=np.float32).reshape(count, 3) ** 3
    assert statistical_inliers(xyz, neighbors=10, std_ratio=0.0).tolist() == [True] * count


def test_the_smallest_cloud_with_statistics() -> None:
    xyz = np.array([[0, 0, 0], [1, 0, 0], [9, 0, 0]], np.float32)
    # Mean distances to both others: 5, 4.5, 8.5; mean 6, sample deviation 2.18.
    assert statistical_inliers(xyz, neighbors=2, std_ratio=1.0).tolist() == [True, True, False]
    assert statistical_inliers(xyz, neighbors=2, std_ratio=1.2).tolist() == [True, True, True]
    assert statistical_inliers(xyz, neighbors=2, std_ratio=-0.5).tolist() == [False, True, False]


def test_exact_duplicates_are_kept() -> None:
    xyz = np.repeat(np.array([[1, 2, 3], [7, 8, 9]], np.float32), 12, axis=0)
    assert statistical_inliers(xyz, neighbors=10, std_ratio=0.0).all()


coordinates = st.floats(-50, 50, width=32)


@given(
    xyz=st.integers(4, 40).flatmap(lambda n: arrays(np.float32, (n, 3), elements=coordinates)),
    neighbors=st.integers(1, 3),
    std_ratio=st.sampled_from([-0.5, 0.0, 0.2, 1.0, 2.0]),
)
def test_equals_brute_force(xyz: F32, neighbors: int, std_ratio: float) -> None:
    expected = by_brute_force(xyz, neighbors, std_ratio)
    keep = statistical_inliers(xyz, neighbors=neighbors, std_ratio=std_ratio)
    decided = ~np.isnan(expected)
    np.testing.assert_array_equal(keep[decided], expected[decided])


def test_the_number_of_threads_changes_nothing() -> None:
    program = (
        "import numpy as np; from pipeline.filters.outliers import statistical_inliers\n"
        "xyz = np.random.default_rng(3).normal(size=(20000, 3)).astype('f4')\n"
        "keep = statistical_inliers(xyz, neighbors=10, std_ratio=0.2)\n"
        "print(np.packbits(keep).tobytes().hex())"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={"OMP_NUM_THREADS": threads, "PATH": ""},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for threads in ("1", "2", "3")
    }
    assert len(outputs) == 1


@pytest.mark.parametrize("crowd", [1, 5, 10, 11, 12, 600])
def test_points_at_one_place_are_taken_as_any_others(crowd: int) -> None:
    rng = np.random.default_rng(crowd)
    alone = rng.uniform(-5, 5, (300, 3))
    xyz = np.concatenate([np.full((600, 3), 2.0), np.full((crowd, 3), 3.0), alone]).astype(np.float32)
    xyz = xyz[rng.permutation(len(xyz))]
    keep = statistical_inliers(xyz, neighbors=10, std_ratio=1.0)
    expected = by_brute_force(xyz, 10, 1.0)
    sure = ~np.isnan(expected)
    np.testing.assert_array_equal(keep[sure], expected[sure].astype(bool))


def test_a_cloud_of_one_point_again_and_again_takes_no_time() -> None:
    xyz = np.full((200_000, 3), 3.0, np.float32)  # by the tree alone: two minutes
    started = time.monotonic()
    assert statistical_inliers(xyz, neighbors=10, std_ratio=1.0).all()
    assert time.monotonic() - started < 10
