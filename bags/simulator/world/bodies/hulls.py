"""Parts of motor vehicles: painted bodies (lofts through cross sections, with wheel arches), wheels, floor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, Shape
from lidcam.bags.simulator.world.mesh import DARK, RUBBER, SEAM, Material, Mesh, box, cylinder, loft, merged, panel
from lidcam.bags.simulator.world.motion import STEERING, ArticulatedPath, Carrier, Poses, hinged
from lidcam.pipeline.core.arrays import F64

Edge = tuple[float, float, float]

ARCH_STEPS = 8
TYRE_WIDTH_M: Mapping[str, float] = {"model_car": 0.027, "car": 0.20, "van": 0.22, "truck": 0.28, "bus": 0.28}
RIM = Material("wheel rim", (0.66, 0.67, 0.69), 0.45, mirror=0.10)
HUB = Material("hub", (0.34, 0.35, 0.37), 0.35, mirror=0.05)


@dataclass(frozen=True, slots=True)
class Hull:
    """A body given by its cross sections."""

    shape: Shape  # of its vehicle
    stations: Sequence[tuple[float, float, float]]  # rows of x (rising), half width and top
    # Rows of height and share of the half width, from below; the last one stands for the top at any height, and levels
    # above the top are lowered to it
    levels: Sequence[tuple[float, float]]
    arch_m: float  # radius of the wheel arches about the axles

    @property
    def bottom_m(self) -> float:
        """Ground clearance."""
        return self.levels[0][0]

    def half_width(self, x: float, z: float) -> float:
        """The y of the left side at a point of the side view."""
        section = self._section(x, self.bottom_m)
        return float(np.interp(z, section[:, 1], section[:, 0]))

    def mesh(self, material: Material) -> Mesh:
        """The closed body, dark below and in its arches."""
        rings = []
        for x, bottom in self._floor():
            right = self._section(x, bottom)
            ring = np.concatenate([right * [-1.0, 1.0], right[::-1]])
            rings.append(np.c_[np.full(len(ring), x), ring])
        floor = 2 * len(self.levels) - 1
        return loft(np.stack(rings), material, where=lambda _, side: DARK if side == floor else material)

    def side_panel(self, outline: npt.ArrayLike, side: int, material: Material, *, thickness: float = 0.008) -> Mesh:
        """A plate on one side (1 left, -1 right); `outline` (K, 2) of x and z runs counter-clockwise from the right."""
        corners = np.array([(x, side * self.half_width(x, z), z) for x, z in np.asarray(outline, np.float64)])
        return panel(corners if side < 0 else corners[::-1], material, thickness=thickness)

    def plate(
        self, x: tuple[float, float], z: tuple[float, float], side: int, material: Material, *, thickness: float
    ) -> Mesh:
        """A `side_panel` that is a rectangle in the side view, between two x and two z."""
        (x0, x1), (z0, z1) = x, z
        return self.side_panel([(x0, z0), (x1, z0), (x1, z1), (x0, z1)], side, material, thickness=thickness)

    def seam(self, x: float, low: float, high: float, width: float, side: int) -> Mesh:
        """An upright joint on one side (1 left, -1 right), along the cross section."""
        heights = [low, *(z for z, _ in self.levels if low < z < high), high]
        spans = pairwise(heights)
        return merged(*(self.plate((x, x + width), span, side, SEAM, thickness=0.5 * width) for span in spans))

    def _section(self, x: float, bottom: float) -> F64:
        """(L, 2) y and z of the left half of a cross section, from below."""
        xs, halves, tops = np.array(self.stations).T
        half, top = float(np.interp(x, xs, halves)), float(np.interp(x, xs, tops))
        levels, shares = np.array(self.levels).T
        crown = shares[-1] / shares[-2]
        # Levels above a low bonnet are lowered to it; the sides stay in plane.
        heights = np.minimum(levels, top - np.linspace(0.05, 0.0, len(levels)) * (top - self.bottom_m))
        heights[0], heights[-1] = self.bottom_m, top
        shares = np.interp(heights, levels, shares)
        shares[-1] = shares[-2] * crown
        return np.stack([half * shares, np.maximum(heights, bottom)], 1)

    def _floor(self) -> list[tuple[float, float]]:
        """The x of all cross sections, rising, and the height of the floor there; it jumps at the ends of an arch."""
        angle = np.linspace(0, np.pi, ARCH_STEPS + 1)
        places: list[tuple[float, float]] = []
        last = -np.inf
        for axle in (0.0, self.shape.wheel_base_m):
            if axle < self.stations[0][0]:  # a cab ends before the rear axle
                continue
            low, high = axle - self.arch_m, axle + self.arch_m
            places += [(x, self.bottom_m) for x, _, _ in self.stations if last < x < low]
            height = np.maximum(self.shape.wheel_radius_m + self.arch_m * np.sin(angle), self.bottom_m)
            arch = axle - self.arch_m * np.cos(angle)
            inner = [x for x, _, _ in self.stations if low < x < high and not np.isclose(arch, x).any()]
            xs = np.sort(np.concatenate([arch, inner]))
            vault = list(zip(xs.tolist(), np.interp(xs, arch, height).tolist(), strict=True))
            places += [(low, self.bottom_m), *vault, (high, self.bottom_m)]
            last = high
        return places + [(x, self.bottom_m) for x, _, _ in self.stations if x > last]


def screen(low: Edge, high: Edge, material: Material, *, thickness: float) -> Mesh:
    """A panel across the body between two edges, each given by x, half width and z; negative half widths face back."""
    (x0, half0, z0), (x1, half1, z1) = low, high
    corners = [(x0, -half0, z0), (x0, half0, z0), (x1, half1, z1), (x1, -half1, z1)]
    return panel(corners, material, thickness=thickness)


def both_sides(mesh: Mesh) -> Mesh:
    """The mesh and its mirror image in the plane y = 0."""
    mirrored = Mesh(
        mesh.vertices * [1.0, -1.0, 1.0], np.ascontiguousarray(mesh.triangles[:, ::-1]), mesh.materials, mesh.palette
    )
    return merged(mesh, mirrored)


@cache
def front_wheel(name: str) -> Mesh:
    """A wheel of a shape about the y axis with its centre at the origin; a vertex is its lowest point."""
    radius, half = SHAPES[name].wheel_radius_m, TYRE_WIDTH_M[name] / 2
    right = [(0.22, -half * 0.85), (0.60, -half * 0.75), (0.66, -half * 0.98), (0.94, -half), (1.0, -half * 0.74)]
    profile = [*right, *((share, -y) for share, y in reversed(right))]
    sides = 28 if radius > 0.4 else 20
    turn = 2 * np.pi * np.arange(sides) / sides - np.pi / 2
    x, z = np.cos(turn), np.sin(turn)
    rings = [np.stack([share * radius * x, np.full(sides, y), share * radius * z], 1) for share, y in profile]
    looks = [RIM, RIM, *[RUBBER] * 5, RIM, RIM]
    return loft(np.stack(rings), RUBBER, where=lambda ring, _: looks[ring], ends=(HUB, HUB))


def steered_wheel(carrier: Carrier, shape: Shape, side: int) -> ArticulatedPath:
    """The path of a front wheel with its centre as origin; `side` is 1 for the left one, -1 for the right one.

    Both wheels roll about one centre on the line of the rear axle, so the inner one turns further (Ackermann).
    """

    def place(states: F64) -> Poses:
        tangent = np.tan(states[:, STEERING])
        near = shape.wheel_base_m - side * shape.track_width_m / 2 * tangent
        turn = np.arctan2(shape.wheel_base_m * tangent, near)
        hinge = np.array([shape.wheel_base_m, side * shape.track_width_m / 2, shape.wheel_radius_m])
        return hinged(turn, 0.0, hinge)

    return ArticulatedPath(carrier, place)


def rear_wheels(name: str, *, twin: bool = False) -> Mesh:
    """The rear wheels of a shape, single or twin, in its base frame."""
    shape = SHAPES[name]
    tyre, y = TYRE_WIDTH_M[name], shape.track_width_m / 2
    places = [y, y - 1.15 * tyre] if twin else [y]
    return merged(
        *(front_wheel(name).moved((0.0, side * place, shape.wheel_radius_m)) for side in (-1, 1) for place in places)
    )


def underbody(shape: Shape, clearance: float, half: float, top: float) -> Mesh:
    """The floor and axles between the wheels, so that nothing shows through below."""
    length = shape.front_m - shape.rear_m
    middle = (shape.front_m + shape.rear_m) / 2
    y, r = shape.track_width_m / 2, shape.wheel_radius_m
    axles = [cylinder((x, -y, r), (x, y, r), 0.12 * r, DARK, sides=8) for x in (0.0, shape.wheel_base_m)]
    floor = box((middle, 0.0, (clearance + top) / 2), (0.94 * length, 2 * half, top - clearance), DARK)
    return merged(floor, *axles)
