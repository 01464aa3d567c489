import itertools
from typing import Any

import numpy as np
import pytest

from lidcam.bags.simulator.scenario.scenario import Scenario, load_scenario
from lidcam.bags.simulator.vehicles.ackermann import HABITS, AckermannCommand
from lidcam.bags.simulator.vehicles.footprints import footprint, overlap
from lidcam.bags.simulator.vehicles.traffic import STEP_NS, Traffic
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
from lidcam.bags.simulator.world.motion import State
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ConfigError

SECOND = 10**9
FORWARD, BACK, STOP = AckermannCommand(0.3), AckermannCommand(-0.3), AckermannCommand()
ALONG = {"points_m": [[0, 0], [200, 0]]}


def traffic(
    vehicles: dict[str, Any], routes: dict[str, Any] | None = None, driven: tuple[str, ...] = (), things: Any = ()
) -> Traffic:
    content = {"world": "open", "vehicles": vehicles, "routes": routes or {}, "things": things}
    return Traffic(Scenario.model_validate(content), driven=driven)


def states(of: Traffic, name: str, seconds: float) -> F64:
    """(N, 6) at every step up to a time."""
    of.advance(round(seconds * SECOND))
    return of.trajectories[name].states(np.arange(0, round(seconds * SECOND) + 1, STEP_NS, dtype=np.int64))


def route(start_m: float = 0.0, speed_m_s: float = 10.0, name: str = "along", shape: str = "car") -> dict[str, Any]:
    return {"shape": shape, "route": name, "route_start_m": start_m, "speed_m_s": speed_m_s}


# --- driven cars


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 200.0])
def test_a_wall_stops_a_car_and_it_can_back_out(yaw_deg: float) -> None:
    yaw = np.deg2rad(yaw_deg)
    wall = {"kind": "box", "position_m": [np.cos(yaw), np.sin(yaw)], "size_m": [0.1, 3, 1], "yaw_deg": yaw_deg}
    cars = traffic({"car1": {"shape": "model_car", "start": [0, 0, yaw_deg]}}, driven=("car1",), things=[wall])
    cars.command("car1", FORWARD)
    way = states(cars, "car1", 5)
    assert way[-1, 3] == 0.0
    room = 0.95 - SHAPES["model_car"].front_m
    assert room - 0.004 < way[-1, 5] < room + 1e-9
    assert cars.blocked_steps("car1") > 100
    cars.command("car1", BACK)
    assert states(cars, "car1", 7)[-1, 5] == pytest.approx(way[-1, 5] - 0.55, abs=0.05)


# --- followers


def test_the_time_of_asking_does_not_matter() -> None:
    one, other = (Traffic(load_scenario("sandbox")) for _ in range(2))
    one.advance(8 * SECOND)
    for until in [*range(0, 8 * SECOND, 70_000_001), 8 * SECOND]:
        other.advance(until)
    assert one.now_ns == other.now_ns == 8 * SECOND
    for name in one.trajectories:
        assert states(one, name, 8).tobytes() == states(other, name, 8).tobytes()


def test_whoever_is_slower_is_followed_at_a_distance() -> None:
    cars = traffic({"a": route(0, 12), "b": route(40, 5)}, {"along": ALONG})
    a, b = states(cars, "a", 20), states(cars, "b", 20)
    gaps = b[:, 0] - a[:, 0] + SHAPES["car"].rear_m - SHAPES["car"].front_m
    assert gaps.min() > 2
    assert gaps[-1] == pytest.approx(HABITS["car"].gap_m + 5 * HABITS["car"].headway_s, abs=3)
    assert a[-1, 3] == pytest.approx(5, abs=0.2)


@pytest.mark.parametrize("shape", ["car", "pedestrian", "bus"])
def test_what_stands_in_the_way_is_waited_for(shape: str) -> None:
    cars = traffic({"a": route(0, 12), "b": {"shape": shape, "start": [80, 0.5, 90]}}, {"along": ALONG})
    way = states(cars, "a", 15)[-1]
    assert way[3] < 0.1
    assert 60 < way[0] + SHAPES["car"].front_m < 80
    assert cars.blocked_steps("a") == 0


ACROSS = {"points_m": [[60, -60], [60, 60]]}


def entered_s(of: Traffic, name: str, seconds: float) -> float:
    """When a front comes to the other's lane, 58 m along either route."""
    way = states(of, name, seconds)
    along = np.where(way[:, 2] == 0, way[:, 0], way[:, 1] + 60)
    return float(np.argmax(along + SHAPES["car"].front_m > 58.0)) / 100


@pytest.mark.parametrize("yields", ["along", "across"])
def test_at_a_crossing_one_lets_pass_whom_its_route_yields_to(yields: str) -> None:
    first = "across" if yields == "along" else "along"
    routes: dict[str, dict[str, Any]] = {"along": ALONG, "across": ACROSS}
    routes[yields] = routes[yields] | {"yields_to": [first]}
    # Whoever yields would even be there a little earlier.
    a, b = (route(2.0 * (yields == name), name=name) for name in ("along", "across"))
    cars = traffic({"a": a, "b": b}, routes)
    times = {"along": entered_s(cars, "a", 15), "across": entered_s(cars, "b", 15)}
    assert times[first] == pytest.approx(5.6, abs=0.4)  # it did not brake
    assert times[yields] > times[first] + 1
    assert cars.blocked_steps("a") == cars.blocked_steps("b") == 0


def test_cars_let_people_cross() -> None:
    routes = {"along": {**ALONG, "yields_to": ["foot"]}, "foot": {"points_m": [[60, -8], [60, 40]]}}
    cars = traffic({"a": route(0), "walker": route(0, 1.4, "foot", "pedestrian")}, routes)
    car, walker = states(cars, "a", 20), states(cars, "walker", 20)
    assert walker[-1, 1] == pytest.approx(-8 + 1.4 * 20, abs=0.1)  # they did not wait
    on_road = np.abs(walker[:, 1]) < 1.5
    assert (car[on_road, 0] + SHAPES["car"].front_m < 59.5).all()
    assert car[-1, 0] > 70


# --- what is refused


@pytest.mark.parametrize(
    ("vehicles", "message"),
    [
        ({"a": route(0), "b": route(2)}, "vehicles.b: expected free ground at its start, found a"),
        ({"a": {"start": [500, 500, 0]}}, "vehicles.a: expected free ground at its start, found an obstacle"),
        ({"a": route(201)}, "vehicles.a.route_start_m: expected at most the length of along, 200.0 m, found 201.0"),
        ({"a": route(0, name="bad")}, "routes.bad: points_m: expected at least 2 corners"),
    ],
)
def test_what_cannot_be_is_refused(vehicles: dict[str, Any], message: str) -> None:
    routes = {"along": ALONG} | ({"bad": {"points_m": [[0, 0]]}} if "bad" in message else {})
    with pytest.raises(ConfigError, match=message):
        traffic(vehicles, routes, things=[{"position_m": [500, 500], "size_m": [1, 1, 1]}])


# --- the scenarios that come with lidcam


@pytest.mark.parametrize(
    "name", ["sandbox", *(pytest.param(one, marks=pytest.mark.slow) for one in ("crossing", "vehicle"))]
)
def test_traffic_flows_and_nobody_touches_anybody(name: str) -> None:
    scenario = load_scenario(name)
    moving = Traffic(scenario)
    of = {name: states(moving, name, 12)[::5] for name in scenario.vehicles}
    shape = {name: SHAPES[vehicle.shape] for name, vehicle in scenario.vehicles.items()}
    for one, other in itertools.combinations(of, 2):
        apart = np.hypot(*(of[one][:, :2] - of[other][:, :2]).T)
        for row in np.flatnonzero(apart < shape[one].size_m[0] + shape[other].size_m[0]):
            grounds = [footprint(shape[each], State(*of[each][row])) for each in (one, other)]
            assert not overlap(*grounds), f"{one} and {other} at {row * 5 * STEP_NS} ns"
    for each, way in of.items():
        assert moving.blocked_steps(each) == 0
        assert way[-1, 5] >= 0.25 * 12 * scenario.vehicles[each].speed_m_s or (way[-1, 5] > 5)
