import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.core.geometry.boxes import box_corners, iou_xyxy, wrap_angle


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


UNIT = (0, 0, 1, 1)
NAN = float("nan")


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (UNIT, UNIT, 1.0),
        ((0.1, 0.2, 0.7, 0.9), (0.1, 0.2, 0.7, 0.9), 1.0),
        (UNIT, (0, 0, 2, 1), 0.5),
        (UNIT, (0.5, 0.5, 1.5, 1.5), 0.25 / 1.75),
        (UNIT, (1, 0, 2, 1), 0.0),
        (UNIT, (2, 2, 3, 3), 0.0),
        (UNIT, (0, 0, 0, 1), 0.0),
        ((5, 5, 2, 2), (2, 2, 5, 5), 0.0),
        ((5, 5, 2, 2), (5, 5, 2, 2), 0.0),
        (UNIT, (NAN, NAN, NAN, NAN), 0.0),
    ],
    ids=["same", "same, rounded", "half", "corner", "edge", "apart", "empty", "inverted", "both inverted", "nan"],
)
def test_pairs(a: tuple[float, ...], b: tuple[float, ...], expected: float) -> None:
    assert iou_xyxy(np.array([a]), np.array([b]))[0, 0] == expected
    assert iou_xyxy(np.array([b]), np.array([a]))[0, 0] == expected


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (2, 0), (2, 3)])
def test_shape(n: int, m: int) -> None:
    assert iou_xyxy(np.zeros((n, 4), np.float32), np.zeros((m, 4), np.float32)).shape == (n, m)


whole = st.tuples(*[st.integers(0, 8)] * 2, *[st.integers(1, 8)] * 2).map(
    lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
)


@given(whole, whole)
def test_equals_counted_pixels(a: tuple[int, ...], b: tuple[int, ...]) -> None:
    grid = np.zeros((2, 16, 16), bool)
    for layer, (left, top, right, bottom) in zip(grid, (a, b), strict=True):
        layer[top:bottom, left:right] = True
    counted = (grid[0] & grid[1]).sum() / (grid[0] | grid[1]).sum()
    assert iou_xyxy(np.array([a]), np.array([b]))[0, 0] == pytest.approx(counted)
