import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_worlds import EvenPath

from lidcam.bags.simulator.world.motion import MountedPath, Poses, turned
from lidcam.pipeline.core.geometry.transform import Transform


def some_poses(count: int, seed: int = 0) -> Poses:
    random = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=random).as_matrix().reshape(-1, 3, 3)
    return Poses(turns, random.uniform(-5, 5, (count, 3)))


def matrices(poses: Poses) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    result = np.tile(np.eye(4), (len(poses), 1, 1))
    result[:, :3, :3], result[:, :3, 3] = poses.rotation, poses.translation
    return result


@pytest.mark.parametrize(("left", "right"), [(4, 4), (1, 4), (4, 1), (1, 1), (0, 0)])
def test_chains_are_products_of_matrices(left: int, right: int) -> None:
    one, other = some_poses(left, 1), some_poses(right, 2)
    np.testing.assert_allclose(matrices(one @ other), matrices(one) @ matrices(other), atol=1e-12)


def test_a_thing_on_a_carrier() -> None:
    carrier = EvenPath((0, 0, 0), (10, 0, 0), 0.0, np.pi / 2)
    mounted = MountedPath(carrier, Transform.from_quaternion("car", "mast", np.array([2.0, 0, 1]), np.eye(4)[3]))
    poses = mounted.poses(np.array([0, 10**9], np.int64))
    np.testing.assert_allclose(poses.translation, [[2, 0, 1], [10, 2, 1]], atol=1e-12)
    np.testing.assert_allclose(turned(poses.rotation, np.tile([1.0, 0, 0], (2, 1))), [[1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert len(mounted.poses(np.empty(0, np.int64))) == 0
