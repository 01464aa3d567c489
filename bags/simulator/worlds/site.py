"""A world in the making: things and road users that do not stand in each other."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lidcam.bags.simulator.scenario.open_world import ThingKind, ThingScenario
from lidcam.bags.simulator.scenario.traffic import RouteScenario, VehicleScenario
from lidcam.bags.simulator.vehicles.footprints import Rectangle, footprint, overlap, things_in_the_way
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.bags.simulator.vehicles.trajectory import State
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of

Box = tuple[float, float, float]

CAR_SIZES: tuple[tuple[float, Box, Box], ...] = (
    (0.65, (3.70, 1.62, 1.52), (0.45, 0.09, 0.09)),
    (0.35, (4.55, 1.80, 1.58), (0.35, 0.10, 0.16)),
)
"""Shares, means and standard deviations of length, width and height: small cars as in KITTI, and larger ones."""


class Site:
    """Things, routes and road users; whatever would stand in something else is not added.

    All random numbers come from `draw`. Things no higher than `step_m`, or that begin above `headroom_m`, are in
    nobody's way.
    """

    def __init__(self, draw: np.random.Generator, *, step_m: float = 0.2, headroom_m: float = 2.2) -> None:
        self.draw = draw
        self.things: list[ThingScenario] = []
        self.routes: dict[str, RouteScenario] = {}
        self.vehicles: dict[str, VehicleScenario] = {}
        self._limits = {"step_m": step_m, "headroom_m": headroom_m}
        self._taken: list[Rectangle] = []
        self._discs = np.empty((0, 3))
        self._roads: dict[str, Route] = {}

    def between(self, low: float, high: float) -> float:
        """A number in [low, high), to the millimetre."""
        return round(float(self.draw.uniform(low, high)), 3)

    def about(self, mean: float, sigma: float, low: float, high: float) -> float:
        """A normal number within limits, to the millimetre."""
        return round(float(np.clip(self.draw.normal(mean, sigma), low, high)), 3)

    def chance(self, share: float) -> bool:
        """Whether something of this probability happens."""
        return bool(self.draw.random() < share)

    def pick(self, *options: Any) -> Any:
        """One of some options."""
        return options[int(self.draw.integers(len(options)))]

    def color(self) -> tuple[float, float, float]:
        """A colour as cars have them: mostly grey."""
        grey, tint = self.between(0.03, 0.95), self.between(0.0, 0.25)
        red, green, blue = (round(min(max(grey + tint * self.between(-1, 1), 0.0), 1.0), 2) for _ in range(3))
        return red, green, blue

    def thing(
        self,
        kind: ThingKind,
        x: float,
        y: float,
        size: Box,
        *,
        yaw_deg: float = 0.0,
        bottom_m: float = 0.0,
        reflectivity: float | None = None,
        color: tuple[float, float, float] | None = None,
        margin_m: float = 0.05,
    ) -> bool:
        """Add a thing if its place is free; whether it was.

        It keeps `margin_m` from all else, or where that is negative may stand in it, as walls do at corners.
        """
        rough = self.between(0.05, 0.75) if reflectivity is None else reflectivity
        made = ThingScenario(
            kind=kind,
            position_m=(round(x, 3), round(y, 3)),
            size_m=size,
            yaw_deg=round(yaw_deg, 2),
            bottom_m=bottom_m,
            color=color or self.color(),
            reflectivity=rough,
        )
        ground = things_in_the_way([made], **self._limits)
        if margin_m >= 0 and not all(self._take(rectangle, margin_m) for rectangle in ground):
            return False
        self.things.append(made)
        return True

    def route(self, name: str, points: tuple[tuple[float, float], ...], yields_to: tuple[str, ...] = ()) -> None:
        """Add an open route."""
        self.routes[name] = RouteScenario(points_m=points, yields_to=yields_to)
        self._roads[name] = Route.from_scenario(self.routes[name])

    def user(self, made: VehicleScenario, *, margin_m: float = 0.15) -> bool:
        """Add a road user if its place is free; whether it was."""
        ground = footprint(shape_of(made.shape, made.scale), first_state(made, self._roads))
        if not self._take(ground, margin_m):
            return False
        self.vehicles["ego" if made.ego else f"{made.shape}_{len(self.vehicles)}"] = made
        return True

    def car(self, **place: Any) -> bool:
        """Add a car of any size and form."""
        row = int(self.draw.random() > CAR_SIZES[0][0])
        _, mean, sigma = CAR_SIZES[row]
        length, width, height = self.draw.normal(mean, sigma).clip(np.array(mean) * 0.72, np.array(mean) * 1.35)
        long, wide, high = SHAPES["car"].body_size_m
        scale = (round(length / long, 3), round(width / wide, 3), round(height / high, 3))
        body = self.pick("hatchback", "hatchback", "saloon", "estate", "mpv")
        return self.user(VehicleScenario(shape="car", body=body, scale=scale, color=self.color(), **place))

    def large(self, **place: Any) -> bool:
        """Add a van, truck or bus."""
        shape = self.pick("van", "van", "van", "truck", "bus")
        long, wide, high = {"van": (0.86, 0.93, 0.86), "truck": (0.95, 0.97, 0.97), "bus": (0.97, 0.98, 1.0)}[shape]
        long, wide = self.about(long, 0.09, 0.7, 1.3), self.about(wide, 0.04, 0.85, 1.1)
        scale = (long, wide, self.about(high, 0.09, 0.7, 1.15))
        return self.user(VehicleScenario(shape=shape, scale=scale, color=self.color(), **place))

    def cyclist(self, **place: Any) -> bool:
        """Add a cyclist."""
        size = self.about(1.01, 0.05, 0.85, 1.12)
        scale = (size, round(size * self.between(0.9, 1.2), 3), round(size * self.between(0.95, 1.05), 3))
        color, walked_m = self.color(), self.between(0, 4.2)
        return self.user(VehicleScenario(shape="cyclist", scale=scale, color=color, walked_m=walked_m, **place))

    def pedestrian(self, *, margin_m: float = 0.05, **place: Any) -> bool:
        """Add a pedestrian, one in twelve a child; some sit, stoop or reach out."""
        height = self.about(0.66, 0.11, 0.45, 0.85) if self.chance(0.08) else self.about(0.965, 0.06, 0.8, 1.12)
        wide = height * self.between(0.95, 1.5)
        scale = (round(wide * self.between(0.85, 1.15), 3), round(wide, 3), height)
        looks: dict[str, Any] = {"scale": scale}
        if "route" not in place and self.chance(0.3):
            looks["posture"] = self.pick("sitting", "stooping", "reaching")
        looks |= {"color": self.color(), "walked_m": self.between(0, 1.28)}
        return self.user(VehicleScenario(shape="pedestrian", **looks, **place), margin_m=margin_m)

    def on_route(self, add: Callable[..., bool], route: str, speed: tuple[float, float], tries: int = 8) -> bool:
        """Add a road user somewhere along a route."""
        for _ in range(tries):
            start_m = self.between(5.0, self._roads[route].length_m - 15.0)
            if add(route=route, route_start_m=start_m, speed_m_s=self.between(*speed)):
                return True
        return False

    def _take(self, ground: Rectangle, margin_m: float) -> bool:
        """Take a rectangle if nothing is there or nearer than a margin."""
        wider = replace(ground, length_m=ground.length_m + 2 * margin_m, width_m=ground.width_m + 2 * margin_m)
        apart = np.hypot(self._discs[:, 0] - wider.x_m, self._discs[:, 1] - wider.y_m) - self._discs[:, 2]
        if any(overlap(wider, self._taken[row]) for row in np.flatnonzero(apart < wider.radius_m).tolist()):
            return False
        self._taken.append(ground)
        self._discs = np.concatenate([self._discs, [[ground.x_m, ground.y_m, ground.radius_m]]])
        return True


def first_state(vehicle: VehicleScenario, routes: dict[str, Route]) -> State:
    """The place of a road user when a recording begins, at its cruising speed."""
    x, y, yaw_deg = vehicle.start
    if not vehicle.route:
        return State(x, y, math.radians(yaw_deg), walked_m=vehicle.walked_m)
    place = routes[vehicle.route].point(vehicle.route_start_m)
    return State(place.x_m, place.y_m, place.yaw_rad, vehicle.speed_m_s, walked_m=vehicle.walked_m)
