import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry.boxes import box_corners, wrap_angle


@given(st.floats(-1e6, 1e6))
def test_wrapped_angles_lie_in_the_half_open_turn_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


@given(st.integers(-1000, 1000), st.integers(-3, 3))
def test_odd_multiples_of_pi_never_leave_the_range(turns: int, ulps: int) -> None:
    angle = (2 * turns + 1) * np.pi
    angle += ulps * np.spacing(angle)
    assert -np.pi < wrap_angle(angle) <= np.pi


def test_wrap_angle_keeps_what_is_in_range() -> None:
    angles = np.array([np.pi, 0.0, -3.0, 1e-300])
    np.testing.assert_array_equal(wrap_angle(angles), angles)
    assert wrap_angle(-np.pi) == np.pi


def test_box_corners_of_a_turned_box() -> None:
    # length 4, width 2, height 1 at (10, 0, 0), turned left by 90 degrees: its front looks to +y
    corners = box_corners(np.array([[10.0, 0, 0]]), np.array([[4.0, 2, 1]]), np.array([np.pi / 2]))[0]
    expected = [[9, 2, -0.5], [9, -2, -0.5], [11, -2, -0.5], [11, 2, -0.5]]
    np.testing.assert_allclose(corners[:4], expected, atol=1e-12)
    np.testing.assert_allclose(corners[4:], np.add(expected, [0, 0, 1]), atol=1e-12)


def test_no_boxes_have_no_corners() -> None:
    assert box_corners(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (0, 8, 3)
