"""Footprints on the ground as rectangles, and their overlap."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bags.simulator.vehicles.trajectory import State
from bags.simulator.world.bodies.dimensions import Shape
from pipeline.core.arrays import F64, I64

__all__ = ["Rectangle", "discs_of", "footprint", "overlap"]


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
