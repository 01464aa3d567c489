"""Traffic, step by step: route followers, cars driven by scripted keys, cars under remote control."""

import math
from bisect import bisect_right
from collections.abc import Collection, Mapping

from lidcam.bags.simulator.scenario.scenario import Scenario, VehicleScenario
from lidcam.bags.simulator.vehicles.ackermann import HABITS, Ackermann, AckermannCommand, chassis_of, commands_of_keys
from lidcam.bags.simulator.vehicles.followers import Follower, Seen
from lidcam.bags.simulator.vehicles.footprints import Obstacles, Rectangle, footprint, in_the_way, overlap
from lidcam.bags.simulator.vehicles.right_of_way import Stretch, Traveller, shared_stretches
from lidcam.bags.simulator.vehicles.routes import Route
from lidcam.bags.simulator.world.bodies.dimensions import shape_of
from lidcam.bags.simulator.world.motion import State, Trajectory
from lidcam.pipeline.core.errors import ConfigError

STEP_NS = 10_000_000
STEPS_PER_DECISION = 5  # from one decision of a driver to the next
DECISION_S = STEPS_PER_DECISION * STEP_NS / 1e9


class _Vehicle:
    """A vehicle or pedestrian, and what controls it."""

    def __init__(
        self, name: str, scenario: VehicleScenario, follower: Follower | None, chassis: Ackermann | None, state: State
    ) -> None:
        self.name, self.follower, self.chassis, self.state = name, follower, chassis, state
        self.shape = shape_of(scenario.shape, scenario.scale)
        self.ground = footprint(self.shape, state)
        self.trajectory = Trajectory(0, state)
        self.script = commands_of_keys(scenario.keys, scenario.key_interval_s)[::-1]
        self.times: list[int] = []
        self.commands: list[AckermannCommand] = []
        self.asked = AckermannCommand()
        self.blocked_steps = 0
        self.near: list[Rectangle | _Vehicle] = []
        self.ask(0, AckermannCommand(state.speed_m_s))

    def ask(self, time_ns: int, command: AckermannCommand) -> None:
        """Set the command."""
        if self.commands and command == self.asked:
            return
        self.asked = command
        if self.times and self.times[-1] == time_ns:
            self.commands[-1] = command
        else:
            self.times.append(time_ns)
            self.commands.append(command)

    def next_state(self, seconds: float) -> State:
        """The next state if nothing blocks the road user."""
        if self.chassis is not None:
            return self.chassis.step(self.state, self.asked, seconds)
        if self.follower is not None:
            return self.follower.walk(self.state, self.asked.speed_m_s, seconds)
        return self.state


class Traffic:
    """The traffic of a scenario, advanced in time.

    A step that would bring a vehicle into another one or into an obstacle leaves it at rest where it is. The vehicles
    in `driven`, none of them a pedestrian, are under remote control (`command`), whatever the scenario says. They begin
    at their `start` if the scenario gives one, and otherwise at the start on their route. Raises ConfigError if a route
    is not valid, or vehicles or obstacles overlap at the start.
    """

    def __init__(self, scenario: Scenario, *, driven: Collection[str] = ()) -> None:
        self._steps = 0
        self._vehicles: dict[str, _Vehicle] = {}
        routes = _routes(scenario)
        for order, (name, vehicle_scenario) in enumerate(scenario.vehicles.items()):
            self._vehicles[name] = _vehicle(order, name, vehicle_scenario, routes, driven=name in driven)
        self._travellers: dict[str, list[Traveller]] = {}
        for vehicle in self._vehicles.values():
            if vehicle.follower is not None:
                traveller = vehicle.follower.traveller
                self._travellers.setdefault(traveller.route, []).append(traveller)
        self._stretches = _stretches_of(scenario, routes, self._travellers)
        self._obstacles = Obstacles(in_the_way(scenario))
        self._refuse_overlaps()
        self.trajectories = {name: vehicle.trajectory for name, vehicle in self._vehicles.items()}
        self.chassis = {name: one.chassis for name, one in self._vehicles.items() if one.chassis is not None}

    @property
    def now_ns(self) -> int:
        """Time simulated so far."""
        return self._steps * STEP_NS

    def advance(self, until_ns: int) -> None:
        """Simulate in whole steps until the time is reached."""
        while self.now_ns < until_ns:
            self._step()

    def command(self, name: str, command: AckermannCommand) -> None:
        """Command a vehicle; it holds until the next command."""
        self._vehicles[name].ask(self.now_ns, command)

    def command_at(self, name: str, time_ns: int) -> AckermannCommand:
        """The command that held at a time."""
        vehicle = self._vehicles[name]
        return vehicle.commands[max(bisect_right(vehicle.times, time_ns) - 1, 0)]

    def blocked_steps(self, name: str) -> int:
        """Number of steps in which a vehicle was blocked."""
        return self._vehicles[name].blocked_steps

    def forget(self, before_ns: int) -> None:
        """Drop states and commands that times from `before_ns` on do not need."""
        for vehicle in self._vehicles.values():
            vehicle.trajectory.forget(before_ns)
            first = max(bisect_right(vehicle.times, before_ns) - 1, 0)
            del vehicle.times[:first], vehicle.commands[:first]

    def _step(self) -> None:
        now_ns = self.now_ns
        if self._steps % STEPS_PER_DECISION == 0:
            self._find_near()
            self._decide(now_ns)
        for vehicle in self._vehicles.values():
            while vehicle.script and vehicle.script[-1][0] <= now_ns:
                vehicle.ask(now_ns, vehicle.script.pop()[1])
            self._move(vehicle)
            vehicle.trajectory.append(now_ns + STEP_NS, vehicle.state)
        self._steps += 1

    def _move(self, vehicle: _Vehicle) -> None:
        state = vehicle.next_state(STEP_NS / 1e9)
        if state == vehicle.state:
            return
        ground = footprint(vehicle.shape, state)
        if any(overlap(ground, other.ground if isinstance(other, _Vehicle) else other) for other in vehicle.near):
            vehicle.state = vehicle.state._replace(speed_m_s=0.0)
            vehicle.blocked_steps += 1
            return
        if vehicle.follower is not None and vehicle.chassis is None:
            vehicle.follower.walked(state.walked_m - vehicle.state.walked_m)
        vehicle.state, vehicle.ground = state, ground

    def _decide(self, now_ns: int) -> None:
        seen = {}
        for vehicle in self._vehicles.values():
            traveller = None
            if vehicle.follower is not None:
                vehicle.follower.observe(vehicle.state)
                traveller = vehicle.follower.traveller
            seen[vehicle.name] = Seen(vehicle.ground, vehicle.state, traveller)
        for vehicle in self._vehicles.values():
            if vehicle.follower is None:
                continue
            others = [other for name, other in seen.items() if name != vehicle.name]
            stretches = self._stretches[vehicle.follower.traveller.route]
            command = vehicle.follower.decide(vehicle.state, DECISION_S, others, stretches, self._travellers)
            vehicle.ask(now_ns, command)

    def _find_near(self) -> None:
        """Collect what each vehicle may reach until the next decision."""
        vehicles = list(self._vehicles.values())
        for vehicle in vehicles:
            reach_m = vehicle.ground.radius_m + DECISION_S * (abs(vehicle.state.speed_m_s) + 2)
            vehicle.near = list(self._obstacles.near(vehicle.ground.x_m, vehicle.ground.y_m, reach_m))
        for row, vehicle in enumerate(vehicles):
            for other in vehicles[row + 1 :]:
                speeds = abs(vehicle.state.speed_m_s) + abs(other.state.speed_m_s)
                if _apart(vehicle.ground, other.ground) < DECISION_S * (speeds + 2):
                    vehicle.near.append(other)
                    other.near.append(vehicle)

    def _refuse_overlaps(self) -> None:
        placed: list[_Vehicle] = []
        for vehicle in self._vehicles.values():
            found = [other.name for other in placed if overlap(vehicle.ground, other.ground)]
            if any(overlap(vehicle.ground, obstacle) for obstacle in self._obstacles.rectangles):
                found.append("an obstacle")
            if found:
                raise ConfigError(
                    f"vehicles.{vehicle.name}: expected free ground at its start, found {found[0]}: "
                    "move its start or route_start_m"
                )
            placed.append(vehicle)


def _apart(one: Rectangle, other: Rectangle) -> float:
    """Distance between the circumscribed circles of two rectangles."""
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) - one.radius_m - other.radius_m


def _routes(scenario: Scenario) -> dict[str, Route]:
    routes = {}
    for name, route in scenario.routes.items():
        try:
            routes[name] = Route.from_scenario(route)
        except ConfigError as err:
            raise ConfigError(f"routes.{name}: {err}") from err
    return routes


def _vehicle(order: int, name: str, vehicle: VehicleScenario, routes: dict[str, Route], *, driven: bool) -> _Vehicle:
    chassis, follower = chassis_of(vehicle.shape, vehicle.scale), None
    x, y, yaw_deg = vehicle.start
    state = State(x, y, math.radians(yaw_deg), walked_m=vehicle.walked_m)
    if vehicle.route:
        route = routes[vehicle.route]
        if not route.closed and vehicle.route_start_m > route.length_m:
            raise ConfigError(
                f"vehicles.{name}.route_start_m: expected at most the length of {vehicle.route}, "
                f"{route.length_m:.1f} m, found {vehicle.route_start_m}"
            )
        follower = Follower(order, vehicle, route)
        if not driven:
            state = follower.first
        elif "start" not in vehicle.model_fields_set:
            state = follower.first._replace(speed_m_s=0.0, walked_m=0.0)
    if driven:
        vehicle, follower = vehicle.model_copy(update={"keys": ""}), None
    return _Vehicle(name, vehicle, follower, chassis, state)


def _stretches_of(
    scenario: Scenario, routes: dict[str, Route], travellers: Mapping[str, Collection[Traveller]]
) -> dict[str, tuple[Stretch, ...]]:
    """The stretches that the routes in use share, by route."""
    shapes, clearance_m = {}, {}
    for name in travellers:
        those = [vehicle for vehicle in scenario.vehicles.values() if vehicle.route == name]
        bodies = (shape_of(vehicle.shape, vehicle.scale) for vehicle in those)
        shapes[name] = max(bodies, key=lambda shape: shape.size_m[1])
        clearance_m[name] = max(HABITS[vehicle.shape].clearance_m for vehicle in those)
    yields_to = {name: scenario.routes[name].yields_to for name in travellers}
    return shared_stretches({name: routes[name] for name in travellers}, shapes, yields_to, clearance_m)
