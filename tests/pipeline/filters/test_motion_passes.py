"""The compiled passes, against the same with arrays."""

import numpy as np
import pytest

from pipeline.core.arrays import F32
from pipeline.core.geometry.transform import Transform
from pipeline.filters.motion_passes import STEP_NS, coordinates, in_range, moved, moved_each


def points(count: int) -> F32:
    xyz = np.random.default_rng(count).normal(0, 20, (count, 3)).astype(np.float32)
    xyz.flags.writeable = False
    return xyz


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_in_range(count: int) -> None:
    xyz = points(count)
    x, y, z = xyz.T
    range_m = np.sqrt(x * x + y * y + z * z)
    np.testing.assert_array_equal(in_range(xyz, 10.0, 30.0), (range_m >= 10) & (range_m <= 30))


def test_limits_of_range_belong_to_it_and_the_origin_does_not() -> None:
    xyz = np.array([[0, 0, 0], [3, 4, 0], [0, 5.1, 0], [0, 0, -1], [0.5, 0, 0], [3e19, 0, 0]], np.float32)
    assert in_range(xyz, 1.0, 5.0).tolist() == [False, True, False, True, False, False]
    assert in_range(xyz, 0.0, 1e300).tolist() == [False, True, True, True, True, True]


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_moved(count: int) -> None:
    turn = Transform.from_quaternion("site", "lidar", [1, 2, 3], [0.1, -0.2, 0.3, 0.9])
    expected = turn.apply(points(count))
    np.testing.assert_array_equal(moved(points(count), turn.matrix[:3].astype(np.float32)), expected)


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_moved_each(count: int) -> None:
    rng = np.random.default_rng(7)
    matrices = rng.normal(size=(6, 3, 4)).astype(np.float32)
    since_ns = rng.integers(0, 5 * STEP_NS, count)
    since_ns[:2] = [0, 5 * STEP_NS - 1][: len(since_ns)]
    knot, rest_ns = np.divmod(since_ns, STEP_NS)
    matrix = matrices[knot] + (rest_ns / STEP_NS)[:, None, None] * (matrices[knot + 1] - matrices[knot])
    expected = np.einsum("nij,nj->ni", matrix[:, :, :3], points(count)) + matrix[:, :, 3]
    np.testing.assert_allclose(moved_each(points(count), since_ns, matrices), expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("count", [0, 1, 1000])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_coordinates(count: int, share: float) -> None:
    kept = np.random.default_rng(1).random(count) < share
    np.testing.assert_array_equal(coordinates(points(count), kept), points(count)[kept].T)
