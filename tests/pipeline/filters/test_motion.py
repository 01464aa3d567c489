"""Points moved, each in its time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.filters.motion import deskew

MS = 1_000_000
STAMP_NS = 1_317_617_735_000_000_000
SPEED_M_S = 10.0
YAW_RATE = 0.5


def pose_at(seconds: float, *, speed: float = SPEED_M_S, yaw_rate: float = YAW_RATE) -> F64:
    """T_map_vehicle of a vehicle that drives along the map's x and turns, far from the map's origin."""
    turn = Rotation.from_euler("z", yaw_rate * seconds).as_matrix()
    return pose_matrix(turn, [3000.0 + speed * seconds, -2000.0, 50.0])


def motion(*stamps_ms: int, speed: float = SPEED_M_S, yaw_rate: float = YAW_RATE) -> PoseSamples:
    stamps_ns = STAMP_NS + np.array(stamps_ms, np.int64) * MS
    poses = np.array([pose_at(ms / 1000, speed=speed, yaw_rate=yaw_rate) for ms in stamps_ms]).reshape(-1, 4, 4)
    return PoseSamples("vehicle", "map", stamps_ns, poses)


def seen_from(pose: F64, xyz_map: F64) -> F64:
    """Points of the map in a vehicle's frame."""
    seen: F64 = (xyz_map - pose[:3, 3]) @ pose[:3, :3]
    return seen


def test_a_wall_that_was_swept_while_driving_and_turning_comes_out_flat() -> None:
    # Wall 20 m ahead of where the vehicle is at the frame's time, swept from right to left in 100 ms around that time.
    times_ms = np.linspace(-50, 50, 1001)
    wall_map = np.stack([np.full(1001, 3020.0), -2000 + np.linspace(-10, 10, 1001), np.full(1001, 51.0)], axis=1)
    measured = np.array(
        [seen_from(pose_at(ms / 1000), p) for ms, p in zip(times_ms, wall_map, strict=True)], np.float32
    )
    stamps_ns = STAMP_NS + np.round(times_ms * MS).astype(np.int64)

    found = deskew(measured, stamps_ns, STAMP_NS, motion(-100, 0, 100))

    assert np.ptp(measured[:, 0]) > 0.9  # by hand: 10 m/s over 0.1 s, and the turn
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[:, 0], 20.0, atol=1e-4)
    np.testing.assert_allclose(found, wall_map - [3000, -2000, 50], atol=1e-4)


@given(
    offset_us=st.lists(st.integers(-100_000, 100_000), min_size=1, max_size=30),
    yaw_rate=st.floats(-1, 1),
    speed=st.floats(-30, 30),
)
def test_moves_each_point_as_its_own_pose_does(offset_us: list[int], yaw_rate: float, speed: float) -> None:
    offsets = np.array(offset_us)
    xyz = np.random.default_rng(0).uniform(-60, 60, (len(offsets), 3)).astype(np.float32)
    found = deskew(xyz, STAMP_NS + offsets * 1000, STAMP_NS, motion(-100, 0, 100, speed=speed, yaw_rate=yaw_rate))
    target = pose_at(0, speed=speed, yaw_rate=yaw_rate)
    poses = [pose_at(us / 1e6, speed=speed, yaw_rate=yaw_rate) for us in offsets]
    expected = [seen_from(target, pose[:3, :3] @ p + pose[:3, 3]) for pose, p in zip(poses, xyz, strict=True)]
    np.testing.assert_allclose(found, np.array(expected), atol=1e-4)


@pytest.mark.parametrize(
    ("stamps_ms", "span_ms", "expected"),
    [
        ((), (0, 0), False),
        ((0,), (0, 0), False),  # one pose says nothing of the motion
        ((0, 100), (0, 100), True),
        ((0, 100), (-200, 300), True),
        ((0, 100), (-201, 100), False),
        ((0, 100), (0, 301), False),
        ((0, 100, 1600), (120, 500), True),
        ((0, 100, 1601), (120, 500), False),  # a gap of 1501 ms
        ((0, 1501), (240, 240), False),
        ((0, 1501), (0, 0), True),
        ((0, 1501, 1601), (1520, 1560), True),
    ],
)
def test_covers(stamps_ms: tuple[int, ...], span_ms: tuple[int, int], expected: bool) -> None:
    first_ms, last_ms = span_ms
    samples = motion(*stamps_ms)
    span_ns = STAMP_NS + first_ms * MS, STAMP_NS + last_ms * MS
    found = samples.covers(*span_ns)
    assert found is expected
