"""Who waits for whom where routes cross or join.

Where the ground that two routes need overlaps, each has a stretch that only one may use at a time. Whoever would be
there together with one that goes first stops before it: one on a route that the own one yields to, or, where neither
yields, one that is there earlier. Whoever is inside, or cannot stop any more, goes first of all.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from bags.simulator.vehicles.routes import Route
from bags.simulator.world.bodies.dimensions import Shape
from pipeline.core.arrays import F64, I64, Bools

__all__ = ["Stretch", "Traveller", "distance_to_stop", "shared_stretches"]

SAME_WAY_RAD = math.radians(20)
"""Ways that go in directions closer than this do not cross: who is behind follows."""

APART_S = 0.8
"""Time that one wants between the other's leaving and its own coming; twice that, once one waits."""

MAX_FOLLOWED = 20
"""Of a queue, as seen from its end; a ring has no first."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Ground that two routes share, as seen from one of them.

    Attributes:
        start_m: Where it begins on the own route.
        length_m: How far it goes.
        other: Name of the other route.
        other_start_m: Where it begins on that.
        other_length_m: How far it goes there.
        yields: Whether the own route gives way.
        first: Whether the other one does.
    """

    start_m: float
    length_m: float
    other: str
    other_start_m: float
    other_length_m: float
    yields: bool
    first: bool


@dataclass(slots=True)
class Traveller:
    """Someone on a route, as others judge it.

    Attributes:
        order: Of equals, the lower one goes first.
        route: Name of the route.
        length_m: Of the route.
        closed: Whether it is.
        front_m: Where the own front is on it.
        body_m: Length from front to rear.
        speed_m_s: Now.
        cruise_m_s: What it aims at.
        acceleration_m_s2: How it gets there.
        hard_braking_m_s2: How it can stop.
        gap_m: Room that it leaves before a line at which it stops.
        stops_in_m: How far its front will come, as far as it knows; infinite if it goes on.
        leader: Who is next on its way.
    """

    order: int
    route: str
    length_m: float
    closed: bool
    front_m: float
    body_m: float
    speed_m_s: float
    cruise_m_s: float
    acceleration_m_s2: float
    hard_braking_m_s2: float
    gap_m: float
    stops_in_m: float = math.inf
    leader: "Traveller | None" = None

    def is_behind(self, other: "Traveller") -> bool:
        """Whether it cannot come anywhere before another one does."""
        leader, seen = self.leader, 0
        while leader is not None and seen < MAX_FOLLOWED:
            if leader is other:
                return True
            leader, seen = leader.leader, seen + 1
        return False

    def distance_to(self, start_m: float, length_m: float) -> float:
        """From its front to a stretch; not positive inside, infinite for one that it has left for good."""
        beyond = self.front_m - start_m
        if self.closed:
            beyond %= self.length_m
            return -beyond if beyond < length_m + self.body_m else self.length_m - beyond
        return -beyond if beyond < length_m + self.body_m else math.inf

    def seconds_for(self, distance_m: float) -> float:
        """Time for a distance, if nothing holds it up."""
        if distance_m <= 0:
            return 0.0
        speed, cruise = self.speed_m_s, max(self.cruise_m_s, self.speed_m_s, 1e-3)
        gaining_s = (cruise - speed) / self.acceleration_m_s2
        gaining_m = (speed + cruise) / 2 * gaining_s
        if distance_m >= gaining_m:
            return gaining_s + (distance_m - gaining_m) / cruise
        rate = self.acceleration_m_s2
        return (math.sqrt(speed * speed + 2 * rate * distance_m) - speed) / rate

    @property
    def braking_m(self) -> float:
        """The shortest way to a stop."""
        return self.speed_m_s**2 / (2 * self.hard_braking_m_s2)


def shared_stretches(
    routes: dict[str, Route],
    shapes: dict[str, Shape],
    yields_to: dict[str, tuple[str, ...]],
    clearance_m: dict[str, float],
) -> dict[str, tuple[Stretch, ...]]:
    """Of each route, in rising order, what it shares with the others.

    Args:
        routes: Those that are travelled.
        shapes: The widest traveller of each.
        yields_to: The routes that each gives way to.
        clearance_m: Room beside the traveller of each.
    """
    names = list(routes)
    stretches: dict[str, list[Stretch]] = {name: [] for name in names}
    samples = {name: _samples(route, shapes[name].size_m[1] / 2) for name, route in routes.items()}
    for row, name in enumerate(names):
        for other in names[row + 1 :]:
            if not (shapes[name].wheel_base_m or shapes[other].wheel_base_m):
                continue  # people on foot make way for each other as they go
            near_m = sum(shapes[one].size_m[1] / 2 + clearance_m[one] for one in (name, other))
            yields, first = other in yields_to[name], name in yields_to[other]
            for mine, its in _stretches(samples[name], samples[other], near_m, routes[name], routes[other]):
                stretches[name].append(Stretch(*mine, other, *its, yields, first))
                stretches[other].append(Stretch(*its, name, *mine, first, yields))
    return {name: tuple(sorted(found, key=lambda stretch: stretch.start_m)) for name, found in stretches.items()}


def distance_to_stop(
    me: Traveller, stretches: Iterable[Stretch], others: Mapping[str, Sequence[Traveller]], horizon_m: float
) -> float:
    """How far someone may go until it has to let others pass; infinite if it need not.

    It stops where it stands in nobody's way, before the first of stretches that follow one another closely.
    """
    ahead = [(me.distance_to(stretch.start_m, stretch.length_m), stretch) for stretch in stretches]
    ahead = sorted((pair for pair in ahead if pair[0] < horizon_m), key=lambda pair: pair[0])
    line_m, free_from_m = math.inf, -math.inf
    for distance_m, stretch in ahead:
        if distance_m > free_from_m:
            line_m = distance_m
        free_from_m = max(free_from_m, distance_m + stretch.length_m + me.body_m + 2 * me.gap_m)
        if distance_m <= me.braking_m:
            continue
        if any(
            _goes_first(other, me, stretch, distance_m) for other in others.get(stretch.other, ()) if other is not me
        ):
            return line_m if line_m > me.braking_m else distance_m
    return math.inf


def _goes_first(other: Traveller, me: Traveller, stretch: Stretch, distance_m: float) -> bool:
    its_m = other.distance_to(stretch.other_start_m, stretch.other_length_m)
    if math.isinf(its_m) or other.is_behind(me):
        return False
    if its_m <= 0:
        return True
    if other.stops_in_m <= its_m:
        return False
    if its_m > other.braking_m and stretch.first:
        return False
    apart_s = APART_S if math.isinf(me.stops_in_m) else 2 * APART_S
    mine_s, its_s = me.seconds_for(distance_m), other.seconds_for(its_m)
    mine_end_s = me.seconds_for(distance_m + stretch.length_m + me.body_m)
    its_end_s = other.seconds_for(its_m + stretch.other_length_m + other.body_m)
    if its_s > mine_end_s + apart_s or mine_s > its_end_s + apart_s:
        return False
    return its_m <= other.braking_m or stretch.yields or (its_s, other.order) < (mine_s, me.order)


def _samples(route: Route, step_m: float) -> tuple[F64, F64]:
    count = math.ceil(route.length_m / step_m)
    along = np.arange(count, dtype=np.float64) * (route.length_m / count)
    return along, route.points(along)


def _stretches(
    mine: tuple[F64, F64],
    its: tuple[F64, F64],
    near_m: float,
    my_route: Route,
    its_route: Route,
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Start and length on the one and on the other of all that they share."""
    (along, points), (its_along, its_points) = mine, its
    dx, dy, turn = (np.subtract.outer(points[:, column], its_points[:, column]) for column in range(3))
    distance2 = dx * dx + dy * dy
    near, crossing = distance2 < near_m**2, np.cos(turn) < math.cos(SAME_WAY_RAD)
    # Where the nearest place of the other route leads the same way, they run side by side, or are one.
    beside = near.any(1) & ~crossing[np.arange(len(along)), distance2.argmin(1)]
    its_beside = near.any(0) & ~crossing[distance2.argmin(0), np.arange(len(its_along))]
    near &= crossing & ~beside[:, None] & ~its_beside
    # A closed route has no end: it is cut where it shares nothing, if there is such a place.
    cut, its_cut = _free_row(near.any(1), my_route), _free_row(near.any(0), its_route)
    marks, count = label(np.roll(near, (-cut, -its_cut), (0, 1)), np.ones((3, 3)))
    found = []
    for number in range(1, count + 1):
        rows, columns = np.nonzero(marks == number)
        found.append((_span(rows, cut, along, my_route), _span(columns, its_cut, its_along, its_route)))
    return found


def _free_row(taken: Bools, route: Route) -> int:
    return int(taken.argmin()) if route.closed else 0


def _span(rows: I64, cut: int, along: F64, route: Route) -> tuple[float, float]:
    step_m = route.length_m / len(along)
    start_m = float(rows.min() + cut) * step_m - step_m / 2
    return (start_m % route.length_m if route.closed else start_m), float(np.ptp(rows) + 1) * step_m
