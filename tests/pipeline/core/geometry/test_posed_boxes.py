import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.posed_boxes import (
    POSITION_SIGMA_M,
    YAW_SIGMA_RAD,
    PosedBoxes,
    UprightBoxes,
    upright_boxes,
)
from lidcam.pipeline.core.geometry.rotations import pose_matrix

OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""R_site_camera of a camera that looks along the site's x axis."""


def posed(rotation: F64, *, center: tuple[float, ...] = (0, 0, 0), covariance: F64 | None = None) -> PosedBoxes:
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    return PosedBoxes(
        np.array([center], np.float64), rotation[None].copy(), np.array([[4.0, 2.0, 1.5]]), covariance[None]
    )


XY2, YAW2 = POSITION_SIGMA_M**2, YAW_SIGMA_RAD**2


def upright(boxes: PosedBoxes, rotation: F64 | None = None, shift: tuple[float, ...] = (0, 0, 0)) -> UprightBoxes:
    return upright_boxes(boxes, pose_matrix(np.eye(3) if rotation is None else rotation, shift))


def about_z(angle_deg: float) -> F64:
    return np.asarray(Rotation.from_euler("z", angle_deg, degrees=True).as_matrix(), np.float64)


@pytest.mark.parametrize("yaw_deg", [-180.0, -90, 0, 30, 180])
def test_a_level_box_in_a_turned_and_moved_frame(yaw_deg: float) -> None:
    found = upright(posed(about_z(yaw_deg), center=(10, 0, 1)), about_z(90), (1, 2, 3))
    np.testing.assert_allclose(found.centers, [[1, 12, 4]], atol=1e-12)
    np.testing.assert_array_equal(found.sizes, [[4, 2, 1.5]])
    expected = np.radians(yaw_deg + 90)
    np.testing.assert_allclose(np.exp(1j * found.yaws), np.exp([1j * expected]), atol=1e-12)
    assert -np.pi < found.yaws[0] <= np.pi


@pytest.mark.parametrize("axis", ["x", "y", "xy"])
@pytest.mark.parametrize("tilt_deg", [-25.0, 10, 40])
def test_a_tilt_of_the_sensor_leaves_size_and_heading(axis: str, tilt_deg: float) -> None:
    tilt = Rotation.from_euler(axis, [tilt_deg] * len(axis) if len(axis) > 1 else tilt_deg, degrees=True).as_matrix()
    found = upright(posed(tilt.T @ about_z(50)), tilt)  # the box is level in the site
    np.testing.assert_array_equal(found.sizes, [[4, 2, 1.5]])
    np.testing.assert_allclose(found.yaws, np.radians([50]))


def test_boxes_in_a_camera_frame() -> None:
    """Identity in optical axes: x right, y down, z ahead; its height is along y."""
    found = upright(posed(np.eye(3), center=(1, 2, 10)), OPTICAL)
    np.testing.assert_allclose(found.centers, [[10, -1, -2]])
    np.testing.assert_array_equal(found.sizes, [[4, 1.5, 2]])
    np.testing.assert_allclose(found.yaws, [-np.pi / 2])
    turned = upright(posed(np.asarray(Rotation.from_euler("y", 90, degrees=True).as_matrix())), OPTICAL)
    np.testing.assert_array_equal(turned.sizes, [[4, 1.5, 2]])
    np.testing.assert_allclose(np.abs(turned.yaws), [np.pi])


angles = st.floats(-180, 180)


@given(angles, angles, angles, angles, angles)
def test_volume_and_highest_axis(roll: float, pitch: float, yaw: float, other: float, third: float) -> None:
    box = np.asarray(Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix())
    frame = np.asarray(Rotation.from_euler("xyz", [other, third, 20], degrees=True).as_matrix())
    found = upright(posed(box), frame)
    assert sorted(found.sizes[0]) == [1.5, 2, 4]
    steepness = np.abs((frame @ box)[2])
    up = [4.0, 2.0, 1.5].index(found.sizes[0, 2])
    assert steepness[up] >= steepness.max() - 1e-6
    along = (frame @ box)[:2, [4.0, 2.0, 1.5].index(found.sizes[0, 0])]
    np.testing.assert_allclose(along / np.hypot(*along), [np.cos(found.yaws[0]), np.sin(found.yaws[0])], atol=1e-9)


def test_covariances_turn_with_the_frame() -> None:
    """Against samples: a box whose pose is drawn from its covariance, seen from the site."""
    rng = np.random.default_rng(3)
    root = rng.normal(0, 0.02, (6, 6))
    covariance = root @ root.T
    frame = np.asarray(Rotation.from_euler("xyz", [3, -4, 70], degrees=True).as_matrix())
    found = upright(posed(about_z(20), covariance=covariance), frame)
    draws = rng.multivariate_normal(np.zeros(6), covariance, 40_000)
    turned = frame @ (Rotation.from_rotvec(draws[:, 3:]).as_matrix() @ about_z(20))
    yaws = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    seen = np.column_stack([draws[:, :3] @ frame.T[:, :2], yaws])
    np.testing.assert_allclose(found.covariances[0], np.cov(seen.T), rtol=0.12, atol=6e-5)


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        pytest.param({}, [XY2, XY2, YAW2], id="nothing is known"),
        pytest.param({(0, 0): 4, (1, 1): 9}, [4, 9, YAW2], id="the position alone"),
        pytest.param({(5, 5): 4}, [XY2, XY2, 4], id="the heading alone"),
        pytest.param({(0, 0): 4, (5, 5): 1}, [XY2, XY2, 1], id="one coordinate"),
        pytest.param({(0, 0): 4, (1, 1): -1, (5, 5): 1}, [XY2, XY2, 1], id="negative"),
        pytest.param({(0, 0): 1, (1, 1): 1, (0, 1): 5, (1, 0): 5, (5, 5): 1}, [XY2, XY2, 1], id="no covariance"),
        pytest.param({(0, 0): 1, (1, 1): 1, (5, 5): 1, (0, 5): 5, (5, 0): 5}, [1, 1, 1], id="too much in common"),
        pytest.param({(0, 0): np.nan, (1, 1): 1, (5, 5): 1}, [XY2, XY2, YAW2], id="not a number"),
        pytest.param({(0, 0): 1, (1, 1): 1, (5, 5): 1, (3, 4): np.inf}, [XY2, XY2, YAW2], id="infinite"),
        pytest.param({(0, 0): 1e300, (1, 1): 1, (5, 5): 1}, [XY2, XY2, YAW2], id="huge"),
    ],
)
def test_what_a_covariance_does_not_say_is_the_default(
    entries: dict[tuple[int, int], float], expected: list[float]
) -> None:
    covariance = np.zeros((6, 6))
    for place, value in entries.items():
        covariance[place] = value
    found = upright(posed(np.eye(3), covariance=covariance)).covariances[0]
    np.testing.assert_array_equal(found, np.diag(expected))


def test_no_boxes() -> None:
    none = PosedBoxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 6, 6)))
    found = upright(none)
    assert (found.centers.shape, found.sizes.shape, found.covariances.shape) == ((0, 3), (0, 3), (0, 3, 3))
