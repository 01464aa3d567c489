"""A world in the making: things and road users that do not stand in each other, and what stands beside roads."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lidcam.bags.simulator.scenario.scenario import RouteScenario, ThingKind, ThingScenario, VehicleScenario
from lidcam.bags.simulator.vehicles.footprints import Rectangle, footprint, overlap, things_in_the_way
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of
from lidcam.bags.simulator.world.motion import State

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
        margin_m: float = 0.05,
        **settings: Any,
    ) -> bool:
        """Add a thing if its place is free; whether it was. `settings` are further ones of `ThingScenario`.

        It keeps `margin_m` from all else, or where that is negative may stand in it, as walls do at corners.
        """
        if "reflectivity" not in settings:
            settings["reflectivity"] = self.between(0.05, 0.75)
        if "color" not in settings:
            settings["color"] = self.color()
        place, turned = (round(x, 3), round(y, 3)), round(yaw_deg, 2)
        made = ThingScenario(kind=kind, position_m=place, size_m=size, yaw_deg=turned, **settings)
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

    def on_route(self, add: Callable[..., bool], route: str, speed: tuple[float, float]) -> None:
        """Add a road user somewhere along a route, if there is room at one of eight places."""
        for _ in range(8):
            start_m = self.between(5.0, self._roads[route].length_m - 15.0)
            if add(route=route, route_start_m=start_m, speed_m_s=self.between(*speed)):
                return

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


Place = tuple[float, float]
Clutter = Callable[[Site, Place, float], None]


def clutter(site: Site, at: Place, yaw_deg: float) -> None:
    """Add one thing, or a few, of the kinds that are taken for road users, at a place on open ground."""
    CLUTTER[int(site.draw.integers(len(CLUTTER)))](site, at, yaw_deg)


def frontage(site: Site, begin: Place, yaw_deg: float, length_m: float) -> None:
    """Line a road: buildings, walls, fences, hedges, trees and bushes one after another, and gaps.

    It begins at a place and runs `length_m` along `yaw_deg`; things stand on its left.
    """
    done, place = site.between(0, 6), partial(_beside, begin, yaw_deg)
    while done < length_m:
        kind = site.pick("building", "building", "wall", "fence", "hedge", "bushes", "bushes", "trees", "gap", "wild")
        piece = site.between(4, 22)
        middle = done + piece / 2
        deep = 0.0 if kind in ("wall", "fence", "hedge") else site.between(0, 6)
        x, y = place(middle, deep)
        if kind == "building":
            depth, high = site.between(5, 12), site.between(2.5, 14)
            x, y = place(middle, deep + depth / 2)
            site.thing("box", x, y, (piece, depth, high), yaw_deg=yaw_deg)
            for _ in range(int(site.draw.integers(0, 5))):  # doorways, bays, drain pipes, steps
                bay = place(done + site.between(0.5, max(piece - 0.5, 0.6)), deep - 0.25)
                size = (site.between(0.1, 1.6), site.between(0.1, 0.45), site.between(0.3, min(high, 3.0)))
                site.thing("box", *bay, size, yaw_deg=yaw_deg, margin_m=0.0)
        elif kind == "wall":
            site.thing("box", x, y, (piece, site.between(0.15, 0.4), site.between(0.4, 2.2)), yaw_deg=yaw_deg)
        elif kind == "fence":
            bent = yaw_deg + site.between(-8, 8)
            site.thing("fence", x, y, (piece, 0.08, site.between(0.7, 2.0)), yaw_deg=bent)
        elif kind == "hedge":
            for number in range(max(int(piece / 4), 1)):  # leaves keep their size
                x, y = place(done + 2 + 4 * number, 0.0)
                site.thing("hedge", x, y, (4.0, site.between(0.5, 1.4), site.between(0.6, 2.2)), yaw_deg=yaw_deg)
        elif kind in ("bushes", "wild"):
            for _ in range(int(piece / (1.5 if kind == "wild" else 2.5)) + 1):
                x, y = place(done + site.between(0, piece), site.between(0, 8 if kind == "wild" else 2))
                plant(site, (x, y))
        elif kind == "trees":
            for ahead in (1.0, piece / 2, piece - 1.0):
                tree(site, place(done + ahead, site.between(0.5, 3)))
        if kind == "gap":
            for _ in range(int(piece / 5)):
                clutter(site, place(done + site.between(0, piece), site.between(0, 8)), yaw_deg)
        done += piece + (site.between(0, 5) if site.chance(0.5) else 0.2)


def _beside(at: Place, yaw_deg: float, ahead: float, left: float = 0.0) -> Place:
    """The place so far ahead and to the left of another one, along a heading."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return at[0] + ahead * cos - left * sin, at[1] + ahead * sin + left * cos


def island(site: Site, at: Place, yaw_deg: float) -> None:
    """Add a planted bed with low shrubs, as long as a parked car and in its place, often with a tree."""
    turned = yaw_deg + site.between(-6, 6)
    kind = site.pick("hedge", "hedge", "bush", "bush", "box")
    size = (site.between(2.0, 5.5), site.between(1.0, 2.3), site.between(0.3, 1.5))
    if not site.thing(kind, *at, size, yaw_deg=turned, color=_green(site)):
        return
    for _ in range(int(site.draw.integers(0, 3))):
        wide = site.between(0.5, size[1])
        place = _beside(at, turned, site.between(-0.5, 0.5) * (size[0] - wide))
        size_of_bush = (wide, wide * site.between(0.6, 1.0), site.between(0.4, 1.8))
        site.thing("bush", *place, size_of_bush, yaw_deg=turned, color=_green(site), margin_m=-1.0)
    if site.chance(0.6):
        wide, high = site.between(2.0, 6.0), site.between(3.0, 9.0)
        site.thing("tree", *at, (wide, wide, high), yaw_deg=turned, color=_green(site), margin_m=-1.0)


def plant(site: Site, at: Place) -> None:
    """Add a bush, from knee height to that of a van, or grass."""
    wide, high = site.between(0.4, 3.6), site.between(0.4, 2.2 if site.chance(0.5) else 4.0)
    kind = site.pick("bush", "bush", "bush", "grass", "conifer")
    if kind == "grass":
        wide, high = site.between(1, 4), site.between(0.25, 1.0)
    elif kind == "conifer":
        wide, high = site.between(0.5, 2.0), site.between(1.0, 5.0)
    size = (wide, wide * site.between(0.5, 1.4), high)
    site.thing(kind, *at, size, yaw_deg=site.between(0, 180), color=_green(site), margin_m=0.0)


def tree(site: Site, at: Place) -> None:
    """Add a tree."""
    wide, high = site.between(1.5, 7), site.between(2.5, 11)
    kind = site.pick("tree", "tree", "tree", "conifer")
    site.thing(kind, *at, (wide, wide, high), yaw_deg=site.between(0, 360), color=_green(site))


def _green(site: Site) -> tuple[float, float, float]:
    return site.between(0.15, 0.4), site.between(0.28, 0.5), site.between(0.1, 0.25)


def _pole(site: Site, at: Place, yaw_deg: float) -> None:
    thick = site.pick(0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4)
    high = site.between(0.8, 8)
    if site.thing("cylinder", *at, (thick, thick, high)) and site.chance(0.5):
        wide = site.between(0.3, 1.2)
        low = round(max(high - site.between(0.4, 1.4), 0.1), 3)
        turned = yaw_deg + site.pick(0, 90) + site.between(-10, 10)
        shiny = site.pick(0.4, 2.0, 3.0)
        size, (x, y) = (0.03, wide, site.between(0.3, 0.9)), _beside(at, turned, thick / 2 + 0.03)
        site.thing("box", x, y, size, yaw_deg=turned, bottom_m=low, reflectivity=shiny, margin_m=0.0)


def _furniture(site: Site, at: Place, yaw_deg: float) -> None:
    """A bin, a cabinet, a crate, a bollard..."""
    kind = site.pick("box", "box", "cylinder", "cone", "table", "lump")
    size = (site.between(0.25, 1.4), site.between(0.25, 0.9), site.between(0.4, 1.9))
    if kind in ("cylinder", "cone"):
        size = (size[1], size[1], size[2])
    site.thing(kind, *at, size, yaw_deg=yaw_deg + site.pick(0, 90) + site.between(-10, 10))


def _person_sized(site: Site, at: Place, yaw_deg: float) -> None:
    """A post, a statue, a parking meter, a traffic light, a dustbin on a pole: as high and wide as a person."""
    high, wide = site.between(1.1, 2.3), site.between(0.15, 0.65)
    kind = site.pick("cylinder", "box", "cone", "lump", "bush", "conifer")
    if site.chance(0.6):
        site.thing(kind, *at, (wide, wide * site.between(0.5, 1.0), high), yaw_deg=yaw_deg + site.between(0, 90))
        return
    thick, head = site.between(0.06, 0.2), site.between(0.25, 1.2)
    low = round(max(high - head - site.between(0.0, 0.3), 0.1), 3)
    size = (max(wide, 0.22), max(wide * site.between(0.5, 1.0), 0.22), head)
    if site.thing("box", *at, size, yaw_deg=yaw_deg + site.between(0, 90), bottom_m=low):
        site.thing("cylinder", *at, (thick, thick, high), margin_m=-1.0)


def _bicycles(site: Site, at: Place, yaw_deg: float) -> None:
    for number in range(int(site.draw.integers(1, 6))):
        x, y = _beside(at, yaw_deg, 0.6 * number)
        size = (site.between(1.5, 1.85), site.between(0.45, 0.65), site.between(0.95, 1.15))
        site.thing("bicycle", x, y, size, yaw_deg=yaw_deg + 90 + site.between(-15, 15))


def _plants(site: Site, at: Place, yaw_deg: float) -> None:
    """A few bushes close together, or bushes in a row as long as a car."""
    for number in range(int(site.draw.integers(1, 5))):
        plant(site, _beside(at, yaw_deg, site.between(0.5, 1.2) * number, site.between(-0.4, 0.4)))


def _bulky(*kinds: ThingKind, size: Sequence[tuple[float, float]], fence_m: float) -> Clutter:
    """Things of some kinds with a size between limits, along the road or across it."""

    def add(site: Site, at: Place, yaw_deg: float) -> None:
        kind = site.pick(*kinds)
        length, width, height = (site.between(*limits) for limits in size)
        turned = yaw_deg + site.pick(0, 0, 90) + site.between(-15, 15)
        site.thing(kind, *at, (length, fence_m if kind == "fence" else width, height), yaw_deg=turned)

    return add


# A skip, a shed, a trailer, a block of hedge, a heap: as large as a car, or as a van.
_car_sized = _bulky(
    *("box", "box", "hedge", "lump", "bush", "fence"), size=((2.2, 5.5), (1.2, 2.6), (0.9, 2.6)), fence_m=0.1
)
# A piece of wall, a container, a kiosk, a bus shelter: higher than a car.
_large = _bulky("box", "box", "hedge", "bush", "fence", size=((2.0, 9.0), (0.3, 3.0), (1.8, 4.2)), fence_m=0.15)

CLUTTER = (
    *(_pole, _pole, _person_sized, _person_sized, _furniture, _furniture),
    *(_bicycles, _plants, _plants, _car_sized, _large, lambda site, at, _: tree(site, at)),
)
