"""Footprints on the ground as rectangles: of vehicles, and of what stands in their way."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from lidcam.bags.simulator.scenario.scenario import Scenario, ThingScenario
from lidcam.bags.simulator.world.bodies.dimensions import Shape
from lidcam.bags.simulator.world.mesh import Mesh
from lidcam.bags.simulator.world.motion import State
from lidcam.bags.simulator.world.places.places import static_mesh
from lidcam.pipeline.core.arrays import F64, I64

TRUNK_SHARE = 0.12  # width of a trunk as a share of the crown's

MODEL_SIZE = {"step_m": 0.03, "headroom_m": 0.22}  # height that cars drive over, and clearance that they need
FULL_SIZE = {"step_m": 0.2, "headroom_m": 2.2}


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle on the ground: its centre, and its length along the yaw."""

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float

    @property
    def radius_m(self) -> float:
        """Radius of the circumscribed circle."""
        return math.hypot(self.length_m, self.width_m) / 2


def footprint(shape: Shape, state: State) -> Rectangle:
    """The footprint of a shape's box."""
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    x, y, _ = shape.box_center_m
    length, width, _ = shape.size_m
    return Rectangle(state.x_m + cos * x - sin * y, state.y_m + sin * x + cos * y, state.yaw_rad, length, width)


def overlap(one: Rectangle, other: Rectangle) -> bool:
    """Whether two rectangles overlap (separating axis theorem)."""
    dx, dy = other.x_m - one.x_m, other.y_m - one.y_m
    turn = other.yaw_rad - one.yaw_rad
    cos, sin = abs(math.cos(turn)), abs(math.sin(turn))
    for yaw, mine, its in ((one.yaw_rad, one, other), (other.yaw_rad, other, one)):
        along, across = math.cos(yaw), math.sin(yaw)
        if 2 * abs(dx * along + dy * across) >= mine.length_m + its.length_m * cos + its.width_m * sin:
            return False
        if 2 * abs(dy * along - dx * across) >= mine.width_m + its.length_m * sin + its.width_m * cos:
            return False
    return True


def discs_of(rectangles: Iterable[Rectangle]) -> tuple[F64, I64]:
    """Discs that cover rectangles: (K, 3) x, y, radius, and (K,) the row of each disc's rectangle."""
    discs, rows = [], []
    for row, rectangle in enumerate(rectangles):
        count = max(round(2 * rectangle.length_m / rectangle.width_m), 1)
        cell = rectangle.length_m / count
        radius = math.hypot(cell, rectangle.width_m) / 2
        cos, sin = math.cos(rectangle.yaw_rad), math.sin(rectangle.yaw_rad)
        for number in range(count):
            along = (number + 0.5) * cell - rectangle.length_m / 2
            discs.append((rectangle.x_m + along * cos, rectangle.y_m + along * sin, radius))
            rows.append(row)
    return np.array(discs, np.float64).reshape(-1, 3), np.array(rows, np.int64)


def obstacles_of(world: Mesh, *, step_m: float, headroom_m: float) -> tuple[Rectangle, ...]:
    """The footprints of the bodies in a static world that a car cannot pass.

    Bodies share no vertices, and each is taken as convex. Those no higher than `step_m` are driven over, as kerbs are;
    those that start above `headroom_m` are driven under, as tree crowns are.
    """
    count = len(world.vertices)
    first, others = np.repeat(world.triangles[:, 0], 2), world.triangles[:, 1:].ravel()
    links = csr_array((np.ones(len(first)), (first, others)), shape=(count, count))
    bodies, body = connected_components(links, directed=False)
    order = np.argsort(body, kind="stable")
    starts = np.searchsorted(body[order], np.arange(bodies + 1))
    z = world.vertices[order, 2]
    low, high = np.minimum.reduceat(z, starts[:-1]), np.maximum.reduceat(z, starts[:-1])
    standing = np.flatnonzero((high > step_m) & (low < headroom_m))
    return tuple(_under(world.vertices[order[starts[row] : starts[row + 1]], :2]) for row in standing)


def things_in_the_way(things: Iterable[ThingScenario], *, step_m: float, headroom_m: float) -> tuple[Rectangle, ...]:
    """The footprints of the things of an open world that a car cannot pass; of a tree, that of its trunk."""
    found = []
    for thing in things:
        (x, y), (length, width, height) = thing.position_m, thing.size_m
        if thing.bottom_m < headroom_m and thing.bottom_m + height > step_m and thing.kind != "grass":
            trunk = TRUNK_SHARE if thing.kind in ("tree", "conifer") else 1.0
            found.append(Rectangle(x, y, math.radians(thing.yaw_deg), trunk * length, trunk * width))
    return tuple(found)


def in_the_way(scenario: Scenario) -> tuple[Rectangle, ...]:
    """The footprints of what a scenario's vehicles cannot pass."""
    model = any(vehicle.shape == "model_car" for vehicle in scenario.vehicles.values())
    if scenario.world == "open":
        return things_in_the_way(scenario.things, **(MODEL_SIZE if model else FULL_SIZE))
    return obstacles_of(static_mesh(scenario.world), **(MODEL_SIZE if scenario.world == "sandbox" else FULL_SIZE))


class Obstacles:
    """Rectangles with a lookup by position."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        self.rectangles = tuple(rectangles)
        columns = [(r.x_m, r.y_m, np.cos(r.yaw_rad), np.sin(r.yaw_rad), r.length_m, r.width_m) for r in rectangles]
        self._table = np.array(columns, np.float64).reshape(-1, 6).T

    def near(self, x_m: float, y_m: float, reach_m: float) -> Iterator[Rectangle]:
        """The rectangles within reach of a position."""
        x, y, cos, sin, length, width = self._table
        dx, dy = x_m - x, y_m - y
        along = np.maximum(np.abs(dx * cos + dy * sin) - length / 2, 0.0)
        across = np.maximum(np.abs(dy * cos - dx * sin) - width / 2, 0.0)
        for row in np.flatnonzero(along**2 + across**2 < reach_m**2):
            yield self.rectangles[row]


def _under(corners: F64) -> Rectangle:
    """The smallest rectangle around points (N, 2), of any yaw."""
    x, y = corners.mean(0).tolist()  # OpenCV uses single precision: stay near the origin
    (dx, dy), (length, width), turn_deg = cv2.minAreaRect((corners - (x, y)).astype(np.float32))
    return Rectangle(x + dx, y + dy, float(np.deg2rad(turn_deg)), length, width)
