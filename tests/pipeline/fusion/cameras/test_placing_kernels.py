"""A step of least squares in one pass, judged by array operations on the same numbers."""

import numpy as np
import pytest

from pipeline.core.arrays import F64
from pipeline.fusion.cameras.placing import (
    CONTACT_SHARE,
    FIRST_STD,
    NEAREST_SHARE,
    ROOF_SHARE,
    SHAPE_STD,
    SHARES,
)
from pipeline.fusion.cameras.placing_kernels import least_squares

GROUND_SLOPE, GROUND_M = 0.008, 0.05


def judged(
    range_m: F64,
    contact_m: F64,
    contact_rise: F64,
    rise: F64,
    back: F64,
    away: F64,
    aside: F64,
    bearing: F64,
    depth: F64,
    depth_std: F64,
    across_std: F64,
    heights: F64,
    seen: F64,
) -> tuple[F64, F64, F64, F64]:
    """As `least_squares`."""
    height, height_std = heights[:, :1], heights[:, 1:]
    lower = contact_rise / contact_m
    top = rise + height
    top_m = np.maximum(range_m + np.where(top > 0, -ROOF_SHARE, ROOF_SHARE) * depth, NEAREST_SHARE * range_m)
    upper = top / top_m
    change = -aside / (away**2 + aside**2) * range_m[..., None]
    left, right = bearing.argmax(-1)[..., None], bearing.argmin(-1)[..., None]
    growth = (np.take_along_axis(change, left, -1) - np.take_along_axis(change, right, -1))[..., 0]
    width = bearing.max(-1) - bearing.min(-1)
    errors = seen[:, 0:1] - lower, seen[:, 1:2] - upper, seen[:, 2:3] - width
    slopes = -lower * range_m / contact_m, -upper * range_m / top_m, growth

    shared = GROUND_SLOPE**2 + (GROUND_M / range_m) ** 2
    depth_variance = (SHAPE_STD * depth) ** 2
    contact_variance = depth_variance + (CONTACT_SHARE * depth_std) ** 2
    a = shared + (lower / contact_m) ** 2 * contact_variance + seen[:, 6:] ** 2
    c = shared + (upper / top_m) ** 2 * depth_variance + (height_std / range_m) ** 2 + seen[:, 4:5] ** 2
    w = (across_std / range_m) ** 2 + seen[:, 3:4] ** 2 + seen[:, 5:6] ** 2
    determinant = a * c - shared * shared

    def inner(x: tuple[F64, F64, F64], y: tuple[F64, F64, F64]) -> F64:
        pair = c * x[0] * y[0] + a * x[1] * y[1] - shared * (x[0] * y[1] + x[1] * y[0])
        return np.asarray(pair / determinant + x[2] * y[2] / w)

    information = inner(slopes, slopes) + FIRST_STD**-2
    square = inner(errors, errors) + (back / FIRST_STD) ** 2
    step = (inner(slopes, errors) + back / FIRST_STD**2) / information
    return step, information, square, determinant * w * information


@pytest.mark.parametrize("count", [0, 1, 50])
def test_same_as_by_array_operations(count: int) -> None:
    rng = np.random.default_rng(count)
    size = count, 12
    range_m = rng.uniform(2, 80, size)
    away, aside = rng.uniform(1, 80, (*size, 4)), rng.uniform(-4, 4, (*size, 4))
    aside[:, :3, 1] = aside[:, :3, 0]  # two corners in one direction
    away[:, :3, 1] = away[:, :3, 0]
    given = (
        range_m,
        range_m * rng.uniform(0.1, 1, size),
        rng.uniform(-3, 3, size),
        rng.uniform(-3, 3, size),
        rng.normal(0, 0.5, size),
        away,
        aside,
        np.arctan2(aside, away),
        rng.uniform(0.2, 6, size),
        rng.uniform(0.02, 1, size),
        rng.uniform(0.02, 1, size),
        rng.uniform(0.1, 3, (count, 2)),
        rng.uniform(0.01, 1, (count, 7)),
    )
    found = least_squares(*given, np.array([GROUND_SLOPE**2, GROUND_M]), SHARES)
    for one, other in zip(found, judged(*given), strict=True):
        np.testing.assert_array_equal(one, other)
