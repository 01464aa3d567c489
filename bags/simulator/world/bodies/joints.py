"""Articulated parts: steered wheels and forks, walking and pedalling legs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import Shape
from lidcam.bags.simulator.world.motion import Poses
from lidcam.pipeline.core.arrays import F64, I64

SPEED, STEERING, WALKED = 3, 4, 5  # columns of `Trajectory.states`
STEP_M = np.linspace(-0.24, 0.24, 7)


class Carrier(Protocol):
    """The path of an articulated thing: a `Trajectory` or a `RaisedPath`."""

    def states(self, times_ns: I64) -> F64:
        """(N, 6) columns as the fields of `lidcam.bags.simulator.vehicles.trajectory.State`, at times (N,)."""

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) of the base frame at times (N,)."""


@dataclass(frozen=True, slots=True)
class RaisedPath:
    """A path over uneven ground."""

    carrier: Carrier  # the path in the plane z = 0
    height: Callable[[F64], F64]  # from positions (N, 2) to heights (N,) of the ground

    def states(self, times_ns: I64) -> F64:
        """The states of the carrier."""
        return self.carrier.states(times_ns)

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) on the ground, smoothed over a foot's length at steps."""
        flat = self.carrier.poses(times_ns)
        ahead, raised = flat.rotation[:, :2, 0], flat.translation.copy()
        under = np.concatenate([raised[:, :2] + offset * ahead for offset in STEP_M])
        raised[:, 2] = self.height(under).reshape(len(STEP_M), -1).mean(axis=0)
        return Poses(flat.rotation, raised)


@dataclass(frozen=True, slots=True)
class ArticulatedPath:
    """The path of a part whose pose on its carrier depends on the carrier's state."""

    carrier: Carrier  # path of the whole thing
    place: Callable[[F64], Poses]  # from states (N, 6) to poses (N) of the part in the carrier's base frame
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors of the carrier's length, width and height

    def poses(self, times_ns: I64) -> Poses:
        """Poses (N) of the part in the world at times (N,)."""
        placed = self.place(self.carrier.states(times_ns))
        return self.carrier.poses(times_ns) @ Poses(placed.rotation, placed.translation * self.scale)


def pitched(angles: F64, x: F64 | float, y: float, z: F64 | float) -> Poses:
    """Poses (N) in the carrier's frame that swing a hanging part forward by angles (N,)."""
    cos, sin, zero, one = np.cos(angles), np.sin(angles), np.zeros_like(angles), np.ones_like(angles)
    rotation = np.stack([cos, zero, -sin, zero, one, zero, sin, zero, cos], -1).reshape(-1, 3, 3)
    return Poses(rotation, np.stack([zero + x, zero + y, zero + z], -1))


def steered_wheel(carrier: Carrier, shape: Shape, side: int) -> ArticulatedPath:
    """The path of a front wheel with its centre as origin; `side` is 1 for the left one, -1 for the right one.

    Both wheels roll about one centre on the line of the rear axle, so the inner one turns further (Ackermann).
    """

    def place(states: F64) -> Poses:
        tangent = np.tan(states[:, STEERING])
        near = shape.wheel_base_m - side * shape.track_width_m / 2 * tangent
        turn = np.arctan2(shape.wheel_base_m * tangent, near)
        hinge = np.array([shape.wheel_base_m, side * shape.track_width_m / 2, shape.wheel_radius_m])
        return _turned(turn, 0.0, hinge)

    return ArticulatedPath(carrier, place)


def steered_fork(carrier: Carrier, hinge: tuple[float, float, float], rake_rad: float) -> ArticulatedPath:
    """The path of a bicycle's fork, which turns about an axis through `hinge` that leans back by `rake_rad`."""

    def place(states: F64) -> Poses:
        return _turned(states[:, STEERING], rake_rad, np.array(hinge))

    return ArticulatedPath(carrier, place)


def _turned(angles: F64, lean_rad: float, hinge: F64) -> Poses:
    """Poses (N) turned to the left about an axis through `hinge` that leans back from the vertical."""
    axis = np.array([-np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    rotation = np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
    return Poses(rotation, np.repeat(hinge[None], len(angles), 0))
