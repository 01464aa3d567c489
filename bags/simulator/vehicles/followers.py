"""Drivers that follow a route, and decide on speed and steering a few times a second."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.bags.simulator.scenario.scenario import VehicleScenario
from lidcam.bags.simulator.vehicles.ackermann import HABITS, AckermannCommand, Habits, chassis_of
from lidcam.bags.simulator.vehicles.footprints import Rectangle, discs_of
from lidcam.bags.simulator.vehicles.right_of_way import Stretch, Traveller, distance_to_stop
from lidcam.bags.simulator.vehicles.routes import Route, pure_pursuit
from lidcam.bags.simulator.world.bodies.dimensions import shape_of
from lidcam.bags.simulator.world.motion import State
from lidcam.pipeline.core.arrays import F64

MAX_STANDING_M_S = 0.02
LINE_GAP = 0.4  # gap before a stop line, as a share of the gap behind a car
REACTION_S = 0.5  # delay before starting when the way becomes free
MIN_SPEED_M_S = 0.05  # a driver who brakes below it stops altogether


@dataclass(frozen=True, slots=True)
class Seen:
    """A vehicle or pedestrian as other drivers see it."""

    ground: Rectangle
    state: State
    traveller: Traveller | None  # its progress on a route; None if it follows none


def following_acceleration(
    habits: Habits, speed_m_s: float, cruise_m_s: float, gap_m: float, ahead_m_s: float
) -> float:
    """The acceleration for a gap to the vehicle ahead and its speed.

    The intelligent driver model (Treiber, Hennecke, Helbing, Physical Review E 62, 2000), limited to hard braking.
    """
    free = 1 - (speed_m_s / cruise_m_s) ** 4 if cruise_m_s > 0 else -1.0
    wanted_m = 0.0
    if math.isfinite(gap_m):
        closing = speed_m_s * (speed_m_s - ahead_m_s)
        comfortable = 2 * math.sqrt(habits.acceleration_m_s2 * habits.braking_m_s2)
        dynamic = speed_m_s * habits.headway_s + closing / comfortable
        wanted_m = habits.gap_m + max(dynamic, 0.0)
    crowded = (wanted_m / max(gap_m, 1e-3)) ** 2
    return max(habits.acceleration_m_s2 * (free - crowded), -habits.hard_braking_m_s2)


class Follower:
    """The driver of a vehicle or pedestrian on a route; its order among all vehicles breaks ties."""

    def __init__(self, order: int, vehicle: VehicleScenario, route: Route) -> None:
        self._route, self._chassis = route, chassis_of(vehicle.shape, vehicle.scale)
        self._shape, self._habits = shape, habits = shape_of(vehicle.shape, vehicle.scale), HABITS[vehicle.shape]
        self._along_m, speed_m_s = vehicle.route_start_m, vehicle.speed_m_s
        self._line_at_m, self._reaction_s = 0.0, 0.0
        self._step_m = shape.size_m[1] / 2
        self._limits = _speed_limits(route, speed_m_s, habits, self._step_m)
        front_m, body_m = self._along_m + shape.front_m, shape.size_m[0]
        self.traveller = Traveller(order, vehicle.route, route, habits, front_m, body_m, speed_m_s, speed_m_s)
        start = route.point(self._along_m)
        self.first = State(start.x_m, start.y_m, start.yaw_rad, self._limit(self._along_m), walked_m=vehicle.walked_m)
        self.traveller.speed_m_s = self.first.speed_m_s

    def observe(self, state: State) -> None:
        """Update its progress on the route from its state."""
        if self._chassis is not None:
            self._along_m = self._route.followed(state.x_m, state.y_m, self._along_m)
        self.traveller.front_m = self._along_m + self._shape.front_m
        self.traveller.speed_m_s = state.speed_m_s
        self.traveller.cruise_m_s = self._limit(self._along_m)

    def decide(
        self,
        state: State,
        seconds: float,
        others: Sequence[Seen],
        stretches: Sequence[Stretch],
        travellers: Mapping[str, Sequence[Traveller]],
    ) -> AckermannCommand:
        """The command until the next decision, by what others do and by what its route shares with theirs."""
        me, habits = self.traveller, self._habits
        speed_m_s = state.speed_m_s
        horizon_m = 4 * habits.gap_m + speed_m_s * (habits.headway_s + 1.5) + speed_m_s**2 / (2 * habits.braking_m_s2)
        line_m = self._line(distance_to_stop(me, stretches, travellers, horizon_m), seconds)
        if not self._route.closed:
            line_m = min(line_m, self._route.length_m - me.front_m + LINE_GAP * habits.gap_m)
        gap_m, ahead_m_s, me.leader = self._gap(state, others, horizon_m)
        limit = self._limit(self._along_m)
        rate = following_acceleration(habits, state.speed_m_s, limit, gap_m, ahead_m_s)
        if math.isfinite(line_m):
            to_stop_m = line_m + (1 - LINE_GAP) * habits.gap_m
            rate = min(rate, following_acceleration(habits, state.speed_m_s, limit, to_stop_m, 0.0))
        me.stops_in_m = min(line_m, gap_m if ahead_m_s < MAX_STANDING_M_S else math.inf)
        speed = max(state.speed_m_s + rate * seconds, 0.0)
        if rate < 0 and speed < MIN_SPEED_M_S * min(limit, 1.0):
            speed = 0.0
        return AckermannCommand(speed, self._steering(state))

    def _line(self, line_m: float, seconds: float) -> float:
        """Distance to the stop line; after a wait the line holds for a reaction time longer."""
        me = self.traveller
        if math.isfinite(line_m):
            self._line_at_m, self._reaction_s = me.front_m + line_m, REACTION_S
            return line_m
        self._reaction_s -= seconds
        left_m = self._line_at_m - me.front_m
        return left_m if self._reaction_s > 0 and left_m > me.braking_m else math.inf

    def walk(self, state: State, speed_m_s: float, seconds: float) -> State:
        """The state of a pedestrian after walking for a time at a target speed."""
        change = speed_m_s - state.speed_m_s
        most = (self._habits.acceleration_m_s2 if change > 0 else self._habits.hard_braking_m_s2) * seconds
        speed = state.speed_m_s + min(max(change, -most), most)
        way = (state.speed_m_s + speed) / 2 * seconds
        place = self._route.point(self._along_m + way)
        return State(place.x_m, place.y_m, place.yaw_rad, speed, 0.0, state.walked_m + way)

    def walked(self, way_m: float) -> None:
        """Advance along the route on foot."""
        self._along_m += way_m

    def _steering(self, state: State) -> float:
        if self._chassis is None:
            return 0.0
        reach_m = self._habits.look_ahead_m + self._habits.look_ahead_s * state.speed_m_s
        goal = self._route.point(self._along_m + reach_m)
        return pure_pursuit(state.x_m, state.y_m, state.yaw_rad, goal, self._shape.wheel_base_m)

    def _gap(self, state: State, others: Sequence[Seen], horizon_m: float) -> tuple[float, float, Traveller | None]:
        """Distance to the first thing ahead within the horizon, its speed along the route, and its traveller."""
        cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        reach_m = horizon_m + self._shape.front_m
        near = []
        for other in others:
            dx, dy = other.ground.x_m - state.x_m, other.ground.y_m - state.y_m
            far = other.ground.radius_m + reach_m
            if dx * dx + dy * dy < far * far and dx * cos + dy * sin > -other.ground.radius_m:
                near.append(other)
        if not near:
            return math.inf, 0.0, None
        discs, rows = discs_of(other.ground for other in near)
        ahead = (discs[:, 0] - state.x_m) * cos + (discs[:, 1] - state.y_m) * sin > self._shape.front_m
        way = np.arange(0.0, reach_m, self._step_m)
        places = self._route.points(self._along_m + way)
        apart2 = ((places[:, None, :2] - discs[None, :, :2]) ** 2).sum(-1)
        room = self._shape.size_m[1] / 2 + self._habits.clearance_m + discs[:, 2]
        touches = (apart2 < room**2) & ahead
        first = np.where(touches.any(0), touches.argmax(0), len(way))
        row = int(first.argmin())
        if first[row] == len(way):
            return math.inf, 0.0, None
        other = near[int(rows[row])]
        along = other.state.speed_m_s * math.cos(other.state.yaw_rad - float(places[first[row], 2]))
        return max(float(way[first[row]]) - self._shape.front_m, 0.0), max(along, 0.0), other.traveller

    def _limit(self, along_m: float) -> float:
        row = int(along_m / self._step_m)
        return float(self._limits[row % len(self._limits) if self._route.closed else min(row, len(self._limits) - 1)])


def _speed_limits(route: Route, cruise_m_s: float, habits: Habits, step_m: float) -> F64:
    """Speed limit at each sample of a route, low enough to brake for curves ahead."""
    along = np.arange(0.0, route.length_m, step_m)
    curvature = np.abs(route.points(along)[:, 3])
    limit2 = np.minimum(cruise_m_s**2, habits.sideways_m_s2 / np.maximum(curvature, 1e-9))
    rounds = 2 if route.closed else 1
    rise = 2 * 0.7 * habits.braking_m_s2 * step_m * np.arange(rounds * len(along))
    earlier = np.minimum.accumulate((np.tile(limit2, rounds) + rise)[::-1])[::-1] - rise
    return np.asarray(np.sqrt(earlier[: len(along)]))
