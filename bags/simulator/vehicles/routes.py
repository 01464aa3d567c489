"""Routes: straights joined by arcs, parametrised by length."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.scenario.scenario import RouteScenario
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ConfigError

MIN_PIECE_M = 1e-9  # length below which pieces are rounding errors


class RoutePoint(NamedTuple):
    """A point on a route."""

    x_m: float
    y_m: float
    yaw_rad: float  # direction of the route, not wrapped: it is continuous along the route
    curvature: float  # 1/m; positive to the left


_Piece = tuple[float, float, float, float, float, float]
"""A straight or an arc: start along the route, length, and the fields of its first `RoutePoint`."""


class Route:
    """A curve over its length, from 0 to `length_m`; a closed one is periodic.

    An open route goes straight on before its start and after its end.
    """

    def __init__(self, pieces: Sequence[_Piece], *, closed: bool) -> None:
        start_m, length_m, _, _, yaw_rad, curvature = pieces[-1]
        self.closed, self.length_m = closed, start_m + length_m
        self._turned = yaw_rad + length_m * curvature - pieces[0][4] if closed else 0.0
        self._table = np.array(pieces, np.float64)

    @classmethod
    def from_scenario(cls, scenario: RouteScenario) -> "Route":
        """The route through the corners of a scenario's route, each rounded with an arc.

        A corner without room for its radius gets the largest that fits between the middles of its sides. Raises
        ConfigError if there are too few corners, two equal ones in a row, or the route turns back on itself.
        """
        corners = [np.array(point[:2]) for point in scenario.points_m]
        radii = [point[2] if len(point) == 3 else scenario.corner_radius_m for point in scenario.points_m]
        fewest = 3 if scenario.closed else 2
        if len(corners) < fewest:
            raise ConfigError(f"points_m: expected at least {fewest} corners, found {len(corners)}")
        return cls(_pieces(corners, radii, closed=scenario.closed), closed=scenario.closed)

    def point(self, along_m: float) -> RoutePoint:
        """The point at a length; on a closed route each round adds a full turn to the yaw."""
        return RoutePoint(*self.points([along_m])[0].tolist())

    def points(self, along_m: npt.ArrayLike) -> F64:
        """`point` for lengths (N,): (N, 4) columns as the fields of `RoutePoint`."""
        along = np.asarray(along_m, np.float64)
        rounds, within = np.divmod(along, self.length_m) if self.closed else (np.zeros_like(along), along)
        row = np.clip(np.searchsorted(self._table[:, 0], within, side="right") - 1, 0, None)
        start, length, x, y, yaw, curvature = self._table[row].T
        on = np.clip(within - start, 0.0, length)
        turn = on * curvature
        chord, towards = on * np.sinc(turn / (2 * np.pi)), yaw + turn / 2
        beyond = within - start - on  # straight on before the start and after the end
        end_yaw = yaw + turn
        x = x + chord * np.cos(towards) + beyond * np.cos(end_yaw)
        y = y + chord * np.sin(towards) + beyond * np.sin(end_yaw)
        curvature = np.where(np.abs(beyond) > MIN_PIECE_M, 0.0, curvature)
        return np.stack([x, y, end_yaw + rounds * self._turned, curvature], -1)

    def followed(self, x_m: float, y_m: float, near_m: float) -> float:
        """Length of the route point nearest to a position, searched near a known length.

        Where the route crosses itself, or in later rounds, it stays on the same branch.
        """
        along = near_m
        for _ in range(3):
            place = self.point(along)
            cos, sin = math.cos(place.yaw_rad), math.sin(place.yaw_rad)
            forward = (x_m - place.x_m) * cos + (y_m - place.y_m) * sin
            left = (y_m - place.y_m) * cos - (x_m - place.x_m) * sin
            along += forward / max(1 - place.curvature * left, 0.5)
        return along


def pure_pursuit(x_m: float, y_m: float, yaw_rad: float, goal: RoutePoint, wheel_base_m: float) -> float:
    """The steering angle for an arc from the rear axle to a goal (Coulter, CMU-RI-TR-92-01, 1992)."""
    dx, dy = goal.x_m - x_m, goal.y_m - y_m
    left = dy * math.cos(yaw_rad) - dx * math.sin(yaw_rad)
    distance2 = dx * dx + dy * dy
    return math.atan(2 * left * wheel_base_m / distance2) if distance2 else 0.0


def _pieces(corners: Sequence[F64], radii: Sequence[float], *, closed: bool) -> list[_Piece]:
    count = len(corners)
    sides = [corners[(row + 1) % count] - corners[row] for row in range(count if closed else count - 1)]
    lengths = [float(np.hypot(*side)) for side in sides]
    for row, length in enumerate(lengths):
        if length < MIN_PIECE_M:
            raise ConfigError(f"points_m: expected distinct neighbouring corners, found {corners[row].tolist()} twice")
    yaws = [math.atan2(side[1], side[0]) for side in sides]
    turns, cuts, arcs = [0.0] * count, [0.0] * count, [0.0] * count
    for row in range(count) if closed else range(1, count - 1):
        turn = math.remainder(yaws[row % len(sides)] - yaws[row - 1], 2 * math.pi)
        if abs(turn) > math.pi - 1e-3:
            raise ConfigError(
                f"points_m: expected a route that goes on, found one that turns back at {corners[row].tolist()}"
            )
        room = min(lengths[row - 1], lengths[row % len(sides)]) / 2
        turns[row] = turn
        cuts[row] = min(radii[row] * math.tan(abs(turn) / 2), room)
        arcs[row] = cuts[row] / math.tan(abs(turn) / 2) if abs(turn) > 1e-9 else 0.0
    pieces: list[_Piece] = []
    along, yaw = 0.0, yaws[0]

    def add_piece(x: float, y: float, length: float, curvature: float) -> None:
        nonlocal along, yaw
        if length > MIN_PIECE_M:
            pieces.append((along, length, x, y, yaw, curvature))
            along += length
        yaw += length * curvature

    for row, (corner, side, length) in enumerate(zip(corners, sides, lengths, strict=False)):
        after = (row + 1) % count
        unit = side / length
        leave, reach = corner + unit * cuts[row], corner + unit * (length - cuts[after])
        add_piece(float(leave[0]), float(leave[1]), length - cuts[row] - cuts[after], 0.0)
        if arcs[after] > 0.0:
            bend = math.copysign(1 / arcs[after], turns[after])
            add_piece(float(reach[0]), float(reach[1]), abs(turns[after]) * arcs[after], bend)
        else:
            yaw += turns[after]
    return pieces
