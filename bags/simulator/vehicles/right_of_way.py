"""Right of way where routes cross or join.

Where two routes overlap, each has a stretch that only one traveller may use at a time. A traveller who would be there
together with another stops before it if its own route yields to the other's, or, where neither yields, if the other
gets there earlier. A traveller who is inside, or too close to stop, always goes first.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from lidcam.bags.simulator.vehicles.ackermann import Habits
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.bags.simulator.world.bodies.dimensions import Shape
from lidcam.pipeline.core.arrays import F64, I64, Bools

MIN_CROSSING_RAD = math.radians(20)  # routes at a smaller angle do not cross: the one behind follows
APART_S = 0.8  # wanted between the other traveller's leaving and one's own arrival; doubled while waiting
PLANNED_BRAKING = 0.5  # share of the hardest braking that plans may use; the rest is for surprises
MAX_LEADERS = 20  # followed up a queue; a ring has no first one


@dataclass(frozen=True, slots=True)
class Stretch:
    """Ground that two routes share, as seen from one of them."""

    start_m: float
    length_m: float
    other: str  # name of the other route, and where the stretch is on that
    other_start_m: float
    other_length_m: float
    yields: bool  # this route gives way
    first: bool  # the other route gives way


@dataclass(slots=True)
class Traveller:
    """A traveller on a route, as others judge it."""

    order: int  # breaks ties: the lower one goes first
    route: str  # its name
    path: Route
    habits: Habits
    front_m: float  # position of its front on the route
    body_m: float  # from front to rear
    speed_m_s: float
    cruise_m_s: float  # target speed
    stops_in_m: float = math.inf  # distance to where its front plans to stop
    leader: "Traveller | None" = None  # the traveller ahead of it

    def is_behind(self, other: "Traveller") -> bool:
        """Whether it queues behind another one."""
        leader, seen = self.leader, 0
        while leader is not None and seen < MAX_LEADERS:
            if leader is other:
                return True
            leader, seen = leader.leader, seen + 1
        return False

    def distance_to(self, start_m: float, length_m: float) -> float:
        """From its front to a stretch; zero or less inside, infinite once it has left for good."""
        beyond = self.front_m - start_m
        if self.path.closed:
            beyond %= self.path.length_m
            return -beyond if beyond < length_m + self.body_m else self.path.length_m - beyond
        return -beyond if beyond < length_m + self.body_m else math.inf

    def seconds_for(self, distance_m: float) -> float:
        """Time for a distance without hindrance."""
        if distance_m <= 0:
            return 0.0
        speed, cruise, rate = self.speed_m_s, max(self.cruise_m_s, self.speed_m_s, 1e-3), self.habits.acceleration_m_s2
        gaining_s = (cruise - speed) / rate
        gaining_m = (speed + cruise) / 2 * gaining_s
        if distance_m >= gaining_m:
            return gaining_s + (distance_m - gaining_m) / cruise
        return (math.sqrt(speed * speed + 2 * rate * distance_m) - speed) / rate

    @property
    def braking_m(self) -> float:
        """Shortest stopping distance that it plans with."""
        return self.speed_m_s**2 / (2 * (PLANNED_BRAKING * self.habits.hard_braking_m_s2))


def shared_stretches(
    routes: dict[str, Route],
    shapes: dict[str, Shape],
    yields_to: dict[str, tuple[str, ...]],
    clearance_m: dict[str, float],
) -> dict[str, tuple[Stretch, ...]]:
    """The stretches that each route shares with others, ordered by start.

    By route are given the shape of its widest traveller, the routes it gives way to, and the room wanted beside it.
    """
    names = list(routes)
    stretches: dict[str, list[Stretch]] = {name: [] for name in names}
    samples = {name: _samples(route, shapes[name].size_m[1] / 2) for name, route in routes.items()}
    for row, name in enumerate(names):
        for other in names[row + 1 :]:
            if not (shapes[name].wheel_base_m or shapes[other].wheel_base_m):
                continue  # pedestrians avoid each other as they go
            near_m = sum(shapes[one].size_m[1] / 2 + clearance_m[one] for one in (name, other))
            yields, first = other in yields_to[name], name in yields_to[other]
            for mine, its in _stretches(samples[name], samples[other], near_m, routes[name], routes[other]):
                stretches[name].append(Stretch(*mine, other, *its, yields, first))
                stretches[other].append(Stretch(*its, name, *mine, first, yields))
    return {name: tuple(sorted(found, key=lambda stretch: stretch.start_m)) for name, found in stretches.items()}


def distance_to_stop(
    me: Traveller, stretches: Iterable[Stretch], others: Mapping[str, Sequence[Traveller]], horizon_m: float
) -> float:
    """Distance to where a traveller must stop to let others pass; infinite if it need not.

    Of stretches in close succession it stops before the first, so that it blocks none of them.
    """
    ahead = [(me.distance_to(stretch.start_m, stretch.length_m), stretch) for stretch in stretches]
    ahead = sorted((pair for pair in ahead if pair[0] < horizon_m), key=lambda pair: pair[0])
    line_m, free_from_m = math.inf, -math.inf
    for distance_m, stretch in ahead:
        if distance_m > free_from_m:
            line_m = distance_m
        free_from_m = max(free_from_m, distance_m + stretch.length_m + me.body_m + 2 * me.habits.gap_m)
        if distance_m <= me.braking_m:
            continue
        rivals = (other for other in others.get(stretch.other, ()) if other is not me)
        if any(_goes_first(other, me, stretch, distance_m) for other in rivals):
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
    mine: tuple[F64, F64], its: tuple[F64, F64], near_m: float, my_route: Route, its_route: Route
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Start and length of each shared stretch, on the one route and on the other."""
    (along, points), (its_along, its_points) = mine, its
    dx, dy, turn = (np.subtract.outer(points[:, column], its_points[:, column]) for column in range(3))
    distance2 = dx * dx + dy * dy
    near, crossing = distance2 < near_m**2, np.cos(turn) < math.cos(MIN_CROSSING_RAD)
    # Where the nearest point of the other route has the same direction, they run side by side or coincide.
    beside = near.any(1) & ~crossing[np.arange(len(along)), distance2.argmin(1)]
    its_beside = near.any(0) & ~crossing[distance2.argmin(0), np.arange(len(its_along))]
    near &= crossing & ~beside[:, None] & ~its_beside
    # Cut a closed route where it shares nothing, if there is such a point.
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
