"""Placing in compiled passes, judged by array operations on the same numbers."""

from dataclasses import replace

import numpy as np
import pytest
from pipeline.fusion.cameras.ground import Ground
from pipeline.fusion.cameras.placing_kernels import (
    bearings_between_sides,
    corners_seen,
    laid_out,
    least_squares,
    places_at,
    rises,
)

from pipeline.core.arrays import F64
from pipeline.core.clouds import CombinedCloud, Plane, PointCloud, Relief
from pipeline.fusion.cameras.placing import (
    CONTACT_SHARE,
    FIRST_STD,
    FORWARD,
    LEFT,
    NEAREST_SHARE,
    ROOF_SHARE,
    SHAPE_STD,
    SHARES,
)

GROUND_SLOPE, GROUND_M = 0.008, 0.05


def empty_cloud() -> CombinedCloud:
    """Without a plane."""
    nothing = np.zeros(0, np.float32), np.zeros(0, np.uint16), np.zeros(0, np.int32)
    cloud, owners = PointCloud(0, "site", np.zeros((0, 3), np.float32), *nothing), np.zeros(0, np.uint8)
    return CombinedCloud(cloud, owners, cloud, owners, cloud, None, {})


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


@pytest.mark.parametrize("count", [0, 1, 20])
def test_corners_and_places(count: int) -> None:
    random = np.random.default_rng(count)
    turn, mean_m = random.uniform(-3, 3, (count, 12)), random.uniform(0.5, 8, (count, 3))
    along, aside, depth = corners_seen(np.cos(turn), np.sin(turn), mean_m, FORWARD, LEFT)
    cos, sin, (length, width) = np.cos(turn)[..., None], np.sin(turn)[..., None], mean_m.T[:2, :, None]
    forward, left = length[..., None] / 2 * FORWARD[0], width[..., None] / 2 * LEFT[0]
    np.testing.assert_array_equal(along, forward * cos - left * sin)
    np.testing.assert_array_equal(aside, forward * sin + left * cos)
    np.testing.assert_array_equal(depth, (length * np.abs(cos[..., 0]) + width * np.abs(sin[..., 0])) / 2)

    range_m, first_m = random.uniform(0.5, 60, (2, count, 12))
    towards, origin = random.normal(size=(count, 2)), random.normal(0, 9, (count, 3))
    contact, back, away, places = places_at(
        range_m, first_m, depth, along, towards, origin, CONTACT_SHARE, NEAREST_SHARE
    )
    np.testing.assert_array_equal(contact, np.maximum(range_m - CONTACT_SHARE * depth, NEAREST_SHARE * range_m))
    np.testing.assert_array_equal(back, first_m / range_m)
    np.testing.assert_array_equal(away, np.maximum(range_m[..., None] + along, NEAREST_SHARE * range_m[..., None]))
    for distance, place in zip((contact, range_m), places, strict=True):
        np.testing.assert_array_equal(place, origin[:, None, :2] + distance[..., None] * towards[:, None])


@pytest.mark.parametrize("has_relief", [True, False])
def test_rises_are_those_of_the_cloud(has_relief: bool) -> None:
    random = np.random.default_rng(2)
    normal = np.array([0.02, -0.03, 1.0])
    plane = Plane(normal / np.linalg.norm(normal), 1.7)
    relief = Relief(np.array([-20.0, -30.0]), 5.0, random.normal(0, 0.2, (9, 7))) if has_relief else None
    combined = replace(empty_cloud(), plane=plane, relief=relief)
    places, origin = random.uniform(-60, 60, (2, 20, 12, 2)), random.normal(0, 3, (20, 3))
    ground = Ground.of(combined, level_m=0.0)
    found = rises(places, places @ ground.plane[:2], origin, ground.plane, ground.relief_m, ground.grid)
    np.testing.assert_array_equal(found, combined.ground_m(places, level_m=0.0) - origin[:, None, 2])
    level = Ground.of(empty_cloud(), level_m=-1.25)
    found = rises(places, places @ level.plane[:2], origin, level.plane, level.relief_m, level.grid)
    np.testing.assert_array_equal(found, np.broadcast_to(-1.25 - origin[:, None, 2], (2, 20, 12)))


@pytest.mark.parametrize("count", [0, 1, 20])
def test_ranges_as_places(count: int) -> None:
    random = np.random.default_rng(count)
    corners, seen = random.uniform(-1, 1, (count, 12, 4)), random.uniform(0.1, 1, (count, 2))
    stds, across = random.uniform(0.01, 1, (count, 4)), random.uniform(0.01, 1, (count, 12))
    range_m, information = random.uniform(1, 60, (2, count, 12))
    bearing, std = bearings_between_sides(corners, seen, stds, across, range_m, 0.004)
    variances = stds[:, ::2, None] ** 2
    share = variances[:, 1] / variances.sum(1)
    by_left, by_right = seen[:, :1] - corners.max(-1), (seen[:, :1] - seen[:, 1:]) - corners.min(-1)
    np.testing.assert_array_equal(bearing, share * by_left + (1 - share) * by_right)
    size_std = (share - 0.5) * across / range_m
    variance = share**2 * variances[:, 0] + (1 - share) ** 2 * variances[:, 1] + size_std**2 + 0.004**2
    np.testing.assert_array_equal(std, np.sqrt(variance))

    origin, cos, sin = random.normal(0, 9, (count, 3)), np.cos(bearing), np.sin(bearing)
    xy, covariances = laid_out(origin, range_m, information, std, cos, sin)
    along, across = range_m**2 / information, (range_m * std) ** 2
    first = np.stack([along * cos**2 + across * sin**2, (along - across) * cos * sin], -1)
    second = np.stack([(along - across) * cos * sin, along * sin**2 + across * cos**2], -1)
    np.testing.assert_array_equal(covariances, np.stack([first, second], -2))
    np.testing.assert_array_equal(xy, origin[:, None, :2] + range_m[..., None] * np.stack([cos, sin], -1))
