import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pipeline.fusion.matching.pairing_kernels import overlapping_pairs

from pipeline.core.arrays import F32
from pipeline.core.geometry.boxes import pair_overlaps_xyxy


def rectangles(random: np.random.Generator, count: int) -> F32:
    corner = random.integers(0, 20, (count, 2))
    extent = random.integers(-1, 15, (count, 2))  # some are empty, some inverted
    return np.concatenate([corner, corner + extent], 1).astype(np.float32)


@given(st.integers(0, 2**31), st.integers(0, 12), st.integers(0, 12), st.sampled_from([-0.9, -0.2, 0.0, 0.3]))
def test_pairs_are_those_of_all_that_are_near_enough(seed: int, first: int, second: int, least: float) -> None:
    random = np.random.default_rng(seed)
    a, b = rectangles(random, first), rectangles(random, second)
    images_a, images_b = np.sort(random.integers(4, size=first)), np.sort(random.integers(4, size=second))
    rows, others = np.nonzero(images_a[:, None] == images_b)
    iou, giou = pair_overlaps_xyxy(a[rows], b[others])
    near = giou >= least
    found = overlapping_pairs(a, images_a, b, images_b, least)
    for values, expected in zip(found, (rows[near], others[near], iou[near]), strict=True):
        np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize("edge", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_near_nothing(edge: float) -> None:
    odd = np.array([[0, 0, edge, 5], [edge, 0, 4, 5]], np.float32)
    whole, image = np.array([[0, 0, 4, 5]], np.float32), np.zeros(1, np.int64)
    assert len(overlapping_pairs(odd, np.zeros(2, np.int64), whole, image, -0.99)[0]) == 0
    assert len(overlapping_pairs(whole, image, odd, np.zeros(2, np.int64), -0.99)[0]) == 0
