import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry.boxes import iou_xyxy

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
