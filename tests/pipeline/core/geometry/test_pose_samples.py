import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from lidcam.pipeline.core.geometry.pose_samples import interpolate_poses

SECOND = 10**9


@given(st.integers(0, 4 * SECOND), st.integers(-(10**18), 10**18))
def test_interpolation_is_slerp_and_linear_at_any_epoch(wanted_ns: int, epoch_ns: int) -> None:
    stamps = np.array([0, SECOND, 4 * SECOND], np.int64)
    turns = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.1, 2.0], [1, -1, 0.5]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = turns.as_matrix()
    poses[:, 0, 3] = [0, 10, -5]
    found = interpolate_poses(stamps + epoch_ns, poses, np.array([wanted_ns + epoch_ns], np.int64))[0]
    judge = Slerp(stamps.astype(float), turns)(float(wanted_ns))
    np.testing.assert_allclose(found[:3, :3], judge.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(found[0, 3], np.interp(wanted_ns, stamps, [0, 10, -5]), atol=1e-9)


def test_beyond_the_ends_the_motion_goes_on() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 1.0
    poses[1, :3, :3] = Rotation.from_euler("z", 0.1).as_matrix()
    wanted = np.array([-SECOND, 2 * SECOND, 3 * SECOND], np.int64)
    found = interpolate_poses(np.array([0, SECOND], np.int64), poses, wanted)
    np.testing.assert_allclose(found[:, 0, 3], [-1, 2, 3])
    np.testing.assert_allclose(Rotation.from_matrix(found[:, :3, :3]).as_euler("zyx")[:, 0], [-0.1, 0.2, 0.3])


def test_interpolating_at_no_time_gives_nothing() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    assert interpolate_poses(np.array([0, 1], np.int64), poses, np.zeros(0, np.int64)).shape == (0, 4, 4)
