import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.bags.simulator.scenario.scenario import RouteScenario
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.pipeline.core.errors import ConfigError

Corners = tuple[tuple[float, ...], ...]
SQUARE: Corners = ((0, 0), (10, 0), (10, 10), (0, 10))
BENT: Corners = ((0, 0), (10, 0), (10, -8), (-4, -9, 1.0))


def route(corners: Corners, *, closed: bool = False, radius: float = 2.0) -> Route:
    return Route.from_scenario(
        RouteScenario.model_validate({"points_m": corners, "closed": closed, "corner_radius_m": radius})
    )


@pytest.mark.parametrize(("corners", "closed"), [(SQUARE, True), (BENT, True), (BENT, False)])
def test_a_place_is_as_far_along_as_the_way_to_it_is_long(corners: Corners, closed: bool) -> None:
    way = route(corners, closed=closed)
    points = way.points(np.linspace(0, way.length_m * (1 - 1e-12), 20_001))
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    np.testing.assert_allclose(steps, way.length_m / 20_000, rtol=1e-6)
    direction = np.unwrap(np.arctan2(*np.diff(points[:, :2], axis=0).T[::-1]))
    np.testing.assert_allclose(np.unwrap(points[:-1, 2]) - direction, 0, atol=1e-3)  # no corner is left
    turn = np.diff(points[:, 2]) / steps
    assert np.mean(np.abs(turn - points[:-1, 3]) > 1e-3) < 1e-3  # but where straights and arcs meet


@given(st.floats(0.0, 40.0), st.floats(-0.8, 0.8), st.floats(-0.7, 0.7))
def test_a_place_beside_the_way_is_followed_from_near_by(along: float, left: float, off: float) -> None:
    way = route(SQUARE, closed=True)
    place = way.point(along)
    x, y = place.x_m - left * math.sin(place.yaw_rad), place.y_m + left * math.cos(place.yaw_rad)
    assert way.followed(x, y, along + off) == pytest.approx(along, abs=0.02)


@pytest.mark.parametrize(
    ("corners", "closed", "message"),
    [
        ((), False, "at least 2 corners, found 0"),
        (((0, 0),), False, "at least 2 corners, found 1"),
        (((0, 0), (1, 0)), True, "at least 3 corners, found 2"),
        (((0, 0), (0, 0), (1, 0)), False, "distinct neighbouring corners"),
        (((0, 0), (5, 0), (1, 0)), False, "turns back"),
    ],
)
def test_ways_that_nobody_can_follow(corners: Corners, closed: bool, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        route(corners, closed=closed)
