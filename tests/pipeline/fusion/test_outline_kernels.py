"""Offsets of round corners in one pass, judged by array operations."""

import numpy as np
import pytest
from pipeline.fusion.outline_kernels import rounded_offsets

UPRIGHT, AS_HIGH_AS_WIDE, TALL, CUT, RIDES = SHAPE = np.array([2.0, 1.2, 0.4, 0.59, 2.0])


@pytest.mark.parametrize(("rounding", "underside", "cabin"), [(0.0, 0.0, 0.0), (0.3, 0.1, 0.2), (0.0, 0.1, 0.2)])
def test_offsets(rounding: float, underside: float, cabin: float) -> None:
    random = np.random.default_rng(1)
    sizes, signs = random.uniform(0.3, 3, (80, 3)), random.choice([-1.0, 0.2, 1.0], (24, 3))
    inward, of_riders = random.choice([-1.0, 0.0, 1.0], (24, 2)), random.normal(size=(24, 3))
    found = rounded_offsets(sizes, signs, inward, of_riders, rounding, underside, cabin, SHAPE)

    length, width, height = sizes.T
    smaller = np.minimum(length, width)
    upright = height > UPRIGHT * smaller
    low = np.clip((AS_HIGH_AS_WIDE - height / width) / (AS_HIGH_AS_WIDE - 1), 0.0, 1.0)
    share = rounding * (TALL + (1 - TALL) * low)
    cut = CUT * (np.where(upright, 0.5 if rounding else 0.0, share) * smaller)
    expected = np.empty((80, 24, 3))
    expected[..., :2] = inward * cut[:, None, None]
    roof = signs[:, 2] == 1
    expected[:, roof, :2] -= signs[roof, :2] * (cabin * low[:, None] * sizes[:, :2] / 2)[:, None]
    expected[..., 2] = np.where(signs[:, 2] < 0, underside, 0.0) * sizes[:, 2:]
    if rounding:
        rides = upright & (length > RIDES * width)
        assert 0 < rides.sum() < 80
        expected[rides] = of_riders * sizes[rides, None] / 2
    np.testing.assert_array_equal(found, expected)


def test_nothing() -> None:
    signs, inward, of_riders = np.zeros((5, 3)), np.zeros((5, 2)), np.zeros((5, 3))
    assert rounded_offsets(np.zeros((0, 3)), signs, inward, of_riders, 0.1, 0.1, 0.1, SHAPE).shape == (0, 5, 3)
