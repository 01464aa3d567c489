"""Cars (full-size and model), vans, trucks and buses in the base frame (below the rear axle); their front wheels."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, Shape, Vector
from lidcam.bags.simulator.world.mesh import (
    CHROME,
    DARK,
    GLASS,
    HEADLAMP,
    METAL,
    PLATE,
    PLATE_YELLOW,
    RUBBER,
    SEAM,
    SIGNAL,
    TAIL_LAMP,
    Material,
    Mesh,
    box,
    cylinder,
    loft,
    merged,
    paint,
    panel,
)
from lidcam.bags.simulator.world.motion import STEERING, ArticulatedPath, Carrier, Poses, hinged
from lidcam.pipeline.core.arrays import F64

ARCH_STEPS = 8
TYRE_WIDTH_M: Mapping[str, float] = {"model_car": 0.027, "car": 0.20, "van": 0.22, "truck": 0.28, "bus": 0.28}
RIM = Material("wheel rim", (0.66, 0.67, 0.69), 0.45, mirror=0.10)
HUB = Material("hub", (0.34, 0.35, 0.37), 0.35, mirror=0.05)

INTERIOR = Material("interior", (0.18, 0.17, 0.17), 0.15)
PAINT = paint((0.123, 0.456, 0.789))  # of all bodies, to be replaced: painting one is far faster than making it

BODIES: Mapping[str, tuple[Sequence[float], Sequence[float]]] = {
    "saloon": ((0.15, 0.30, 0.665, 0.725), (0.22, 0.32, 0.535, 0.575)),
    "estate": ((0.025, 0.23, 0.665, 0.725), (0.05, 0.22, 0.535, 0.575)),
    "mpv": ((0.025, 0.23, 0.72, 0.82), (0.06, 0.22, 0.60, 0.66)),
}
"""Shares of the length where a body has the rows of a hatchback's windows: at the belt line, and at the roof."""
BELT_ROWS, ROOF_ROWS = (0.03, 0.245, 0.665, 0.725), (0.11, 0.265, 0.535, 0.575)  # of the hatchback

CAR_STATIONS = (
    (0.004, 0.84, 0.56), (0.012, 0.93, 0.61), (0.05, 0.98, 0.645), (0.14, 1.0, 0.655), (0.68, 1.0, 0.635),
    (0.74, 1.0, 0.62), (0.90, 0.97, 0.545), (0.950, 0.93, 0.505), (0.980, 0.86, 0.460), (0.994, 0.74, 0.41),
)  # fmt: skip
CAR_LEVELS = ((0.13, 0.94), (0.20, 0.985), (0.36, 1.0), (0.53, 0.985), (0.60, 0.95), (0.65, 0.86))
"""Stations and levels as of `Hull`, in shares of length, half width and height."""


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


def screen(low: Vector, high: Vector, material: Material, *, thickness: float) -> Mesh:
    """A panel across the body between two edges, each given by x, half width and z; negative half widths face back."""
    (x0, half0, z0), (x1, half1, z1) = low, high
    corners = [(x0, -half0, z0), (x0, half0, z0), (x1, half1, z1), (x1, -half1, z1)]
    return panel(corners, material, thickness=thickness)


def both_sides(mesh: Mesh) -> Mesh:
    """The mesh and its mirror image in the plane y = 0."""
    triangles = np.ascontiguousarray(mesh.triangles[:, ::-1])
    return merged(mesh, Mesh(mesh.vertices * [1.0, -1.0, 1.0], triangles, mesh.materials, mesh.palette))


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
        base_m, beside_m, tangent = shape.wheel_base_m, side * shape.track_width_m / 2, np.tan(states[:, STEERING])
        turn = np.arctan2(base_m * tangent, base_m - beside_m * tangent)
        return hinged(turn, 0.0, np.array([base_m, beside_m, shape.wheel_radius_m]))

    return ArticulatedPath(carrier, place)


def rear_wheels(name: str, *, twin: bool = False) -> Mesh:
    """The rear wheels of a shape, single or twin, in its base frame."""
    shape = SHAPES[name]
    tyre, y = TYRE_WIDTH_M[name], shape.track_width_m / 2
    places = [side * place for side in (-1, 1) for place in ([y, y - 1.15 * tyre] if twin else [y])]
    return merged(*(front_wheel(name).moved((0.0, place, shape.wheel_radius_m)) for place in places))


def underbody(shape: Shape, clearance: float, half: float, top: float) -> Mesh:
    """The floor and axles between the wheels, so that nothing shows through below."""
    length, middle = shape.front_m - shape.rear_m, (shape.front_m + shape.rear_m) / 2
    y, r = shape.track_width_m / 2, shape.wheel_radius_m
    axles = [cylinder((x, -y, r), (x, y, r), 0.12 * r, DARK, sides=8) for x in (0.0, shape.wheel_base_m)]
    floor = box((middle, 0.0, (clearance + top) / 2), (0.94 * length, 2 * half, top - clearance), DARK)
    return merged(floor, *axles)


@cache
def motor_vehicle(shape: str, form: str = "hatchback") -> Mesh:
    """A motor vehicle of `PAINT`, rear wheels included; `form` is that of a `car`, one of `CarBody`."""
    if shape == "model_car":  # at about 1:14
        return _passenger_car(shape, "hatchback", arch=0.0405, inset=0.060)
    if shape == "car":
        return _passenger_car(shape, form, arch=0.355, inset=0.55)
    return {"van": _van, "truck": _truck, "bus": _bus}[shape]()


def _boxes(*rows: tuple[Vector, Vector, Material]) -> list[Mesh]:
    """Boxes by centre, size and material; one beside the middle plane has a mirror image."""
    return [both_sides(box(*row)) if row[0][1] else box(*row) for row in rows]


def _passenger_car(name: str, form: str, *, arch: float, inset: float) -> Mesh:
    """A car that fills the box of its shape.

    In metres: the radius of the wheel arches, and half the width of the floor between the wheels.
    """
    shape = SHAPES[name]
    low, width, (length, _, height) = shape.bottom_m, shape.body_size_m[1], shape.size_m
    half = width / 2

    def x(share: float) -> float:
        return shape.rear_m + share * length

    def z(share: float) -> float:
        return low + share * height

    stations = [(x(along), wide * half, z(top)) for along, wide, top in CAR_STATIONS]
    hull = Hull(shape, stations, [(z(level), wide) for level, wide in CAR_LEVELS], arch)
    thin, wide = 0.006 * length, 0.29 * width
    deep = 0.8 * thin
    front, rear = x(1.0) - deep, x(0.0) + deep
    mirror_x, mirror_z, mirror = x(0.655), z(0.625), 0.085 * height
    side_y, reach = hull.half_width(mirror_x, z(0.60)), shape.size_m[1] / 2
    inner = 0.94 * side_y
    parts = [
        hull.mesh(PAINT),
        _car_cabin(x, z, half, form),
        underbody(shape, z(0.14), inset, z(0.45)),
        rear_wheels(name),
        *_boxes(
            ((x(0.45), 0.0, z(0.50)), (0.42 * length, 1.2 * half, 0.36 * height), INTERIOR),
            ((front, 0.0, z(0.215)), (deep, 1.05 * half, 0.13 * height), DARK),
            ((front, 0.0, z(0.375)), (deep, 0.90 * half, 0.045 * height), DARK),
            ((x(1.0) - 0.5 * thin, 0.0, z(0.275)), (thin, wide, 0.075 * height), PLATE),
            ((x(0.0) + 0.5 * thin, 0.0, z(0.40)), (thin, wide, 0.075 * height), PLATE_YELLOW),
            ((rear, 0.0, z(0.20)), (deep, 1.3 * half, 0.11 * height), DARK),
            ((front, 0.60 * half, z(0.365)), (deep, 0.24 * half, 0.075 * height), HEADLAMP),
            ((front, 0.62 * half, z(0.21)), (deep, 0.12 * half, 0.06 * height), HEADLAMP),
            ((rear, 0.72 * half, z(0.485)), (deep, 0.24 * half, 0.13 * height), TAIL_LAMP),
            ((mirror_x, (inner + reach) / 2, mirror_z), (0.9 * mirror, reach - inner, mirror), PAINT),
            (
                (mirror_x - 0.46 * mirror, (side_y + reach) / 2, mirror_z),
                (0.06 * mirror, 0.8 * (reach - side_y), 0.8 * mirror),
                CHROME,
            ),
        ),
    ]
    lamp = [(x(0.952), z(0.365)), (x(0.993), z(0.328)), (x(0.993), z(0.402)), (x(0.952), z(0.43))]
    tail = [(x(0.006), z(0.42)), (x(0.04), z(0.44)), (x(0.04), z(0.55)), (x(0.006), z(0.55))]
    seam = 0.003 * length
    for side in (-1, 1):
        parts += [
            hull.side_panel(lamp, side, HEADLAMP, thickness=0.03 * width),
            hull.side_panel(tail, side, TAIL_LAMP, thickness=0.02 * width),
            hull.plate((x(0.31), x(0.71)), (z(0.135), z(0.185)), side, DARK, thickness=0.02 * width),
            *(hull.seam(x(share), z(0.19), z(0.62), seam, side) for share in (0.655, 0.43)),
            hull.seam(x(0.245), z(0.42), z(0.62), seam, side),
        ]
        for share in (0.455, 0.275):  # handles
            ends, heights = (x(share), x(share + 0.035)), (z(0.555), z(0.572))
            parts.append(hull.plate(ends, heights, side, CHROME, thickness=0.018 * width))
    return merged(*parts)


def _car_cabin(x: Callable[[float], float], z: Callable[[float], float], half: float, form: str) -> Mesh:
    """Windows all round, pillars and a roof."""
    # From the rear right corner forward: shares of length and half width at the belt line, the same at the roof, and
    # whether the strip up to the next row is glass; the last one is the windscreen.
    outline = (
        (0.030, 0.70, 0.110, 0.54, False), (0.055, 0.84, 0.125, 0.62, False), (0.135, 0.86, 0.165, 0.66, True),
        (0.245, 0.87, 0.265, 0.67, True), (0.43, 0.88, 0.43, 0.67, False), (0.455, 0.88, 0.45, 0.67, True),
        (0.63, 0.87, 0.535, 0.66, False), (0.665, 0.86, 0.55, 0.64, True), (0.725, 0.52, 0.575, 0.40, True),
    )  # fmt: skip
    belt, roof = [row[:2] for row in outline], [row[2:4] for row in outline]
    if form in BODIES:
        belt_rows, roof_rows = BODIES[form]
        belt = [(float(np.interp(share, BELT_ROWS, belt_rows)), wide) for share, wide in belt]
        roof = [(float(np.interp(share, ROOF_ROWS, roof_rows)), wide) for share, wide in roof]
    glass = [row[4] for row in outline]
    strips = [*glass, *glass[-2::-1], True]  # the last one is the rear window

    def ring(points: list[tuple[float, float]], level: float, shrink: float) -> list[Vector]:
        middle = x(0.33)
        right = [(middle + (x(a) - middle) * shrink, -half * b * shrink, z(level)) for a, b in points]
        return right + [(a, -b, c) for a, b, c in right[::-1]]

    rings = [
        *(ring(belt, 0.60, 1.0), ring(belt, 0.655, 0.995)),
        *(ring(roof, 0.945, 1.0), ring(roof, 0.982, 0.95), ring(roof, 1.0, 0.80)),
    ]
    return loft(rings, PAINT, where=lambda level, strip: GLASS if level == 1 and strips[strip] else PAINT)


def _van() -> Mesh:
    shape = SHAPES["van"]
    stations = (
        (-1.09, 0.94, 2.44), (-1.07, 0.99, 2.49), (2.75, 1.0, 2.50), (3.00, 0.99, 2.46), (3.95, 0.98, 1.42),
        (4.10, 0.97, 1.34), (4.60, 0.92, 1.12), (4.74, 0.86, 0.98), (4.78, 0.78, 0.80),
    )  # fmt: skip
    levels = ((0.30, 0.95), (0.40, 0.99), (0.70, 1.0), (1.25, 0.99), (2.34, 0.91), (2.45, 0.86), (2.5, 0.76))
    rear_window = [(-1.09, 0.76, 1.45), (-1.09, 0.06, 1.45), (-1.09, 0.06, 2.15), (-1.09, 0.70, 2.15)]
    boxes = (
        ((4.782, 0.0, 0.63), (0.024, 1.20, 0.20), DARK), ((4.782, 0.0, 0.39), (0.024, 1.40, 0.15), DARK),
        ((4.79, 0.0, 0.45), (0.02, 0.52, 0.11), PLATE), ((-1.095, 0.0, 0.62), (0.01, 0.52, 0.11), PLATE_YELLOW),
        ((-1.088, 0.0, 0.38), (0.012, 1.80, 0.16), DARK), ((-1.092, 0.0, 1.35), (0.012, 0.02, 1.8), SEAM),
        ((4.782, 0.66, 0.69), (0.024, 0.18, 0.18), HEADLAMP), ((-1.085, 0.86, 1.05), (0.03, 0.13, 0.46), TAIL_LAMP),
        ((-1.085, 0.86, 1.36), (0.03, 0.12, 0.12), SIGNAL), ((3.62, 1.10, 1.62), (0.13, 0.14, 0.34), DARK),
        ((3.64, 1.02, 1.52), (0.06, 0.16, 0.05), DARK),
    )  # fmt: skip
    hull = Hull(shape, stations, levels, 0.40)
    parts = [
        hull.mesh(PAINT),
        underbody(shape, 0.28, 0.60, 0.80),
        rear_wheels("van"),
        screen((3.92, 0.88, 1.46), (3.05, 0.80, 2.40), GLASS, thickness=0.03),
        *_boxes(*boxes),
        both_sides(panel(rear_window, GLASS, thickness=0.012)),
    ]
    window = [(2.32, 1.46), (3.70, 1.46), (3.06, 2.20), (2.32, 2.20)]
    for side in (-1, 1):
        parts += [hull.side_panel(window, side, GLASS, thickness=0.03)]
        parts += [hull.seam(x, 0.42, top, 0.016, side) for x, top in ((0.62, 2.3), (2.22, 2.3), (3.12, 1.44))]
        parts.append(hull.plate((0.50, 3.08), (0.58, 0.72), side, DARK, thickness=0.04))
        parts += [hull.plate((x, x + 0.16), (1.26, 1.30), side, DARK, thickness=0.05) for x in (2.36, 2.0)]
    return merged(*parts)


def _truck() -> Mesh:
    """A truck with a white box body behind a painted cab."""
    white = Material("box body", (0.86, 0.87, 0.88), 0.62, mirror=0.02)
    stations = (
        (4.25, 1.20, 2.86), (4.32, 1.235, 2.90), (5.95, 1.235, 2.90), (6.22, 1.22, 2.84), (6.34, 1.20, 1.55),
        (6.385, 1.14, 1.30),
    )  # fmt: skip
    levels = ((0.42, 0.96), (0.55, 1.0), (1.50, 1.0), (2.60, 0.95), (2.80, 0.90), (2.90, 0.80))
    boxes = (
        ((1.95, 0.42, 0.88), (8.1, 0.09, 0.24), METAL), ((4.9, 0.0, 0.85), (2.3, 1.1, 0.5), DARK),
        ((0.90, 0.0, 2.255), (6.20, 2.50, 2.47), white), ((0.90, 0.0, 1.03), (6.18, 2.46, 0.10), METAL),
        ((0.90, 1.253, 3.44), (6.20, 0.02, 0.10), METAL), ((0.90, 1.253, 1.10), (6.20, 0.02, 0.12), METAL),
        ((4.00, 1.235, 2.25), (0.06, 0.06, 2.46), METAL), ((-2.175, 1.235, 2.25), (0.05, 0.06, 2.46), METAL),
        ((-2.195, 0.0, 2.25), (0.012, 0.03, 2.40), METAL), ((-2.194, 0.35, 2.0), (0.012, 0.03, 1.8), METAL),
        ((-2.12, 0.0, 0.55), (0.10, 2.30, 0.14), METAL), ((-2.12, 0.50, 0.75), (0.08, 0.08, 0.40), METAL),
        ((-2.178, 0.95, 0.56), (0.03, 0.36, 0.12), TAIL_LAMP), ((-2.18, 0.0, 0.55), (0.03, 0.52, 0.11), PLATE_YELLOW),
        ((6.375, 0.0, 1.12), (0.03, 1.7, 0.36), DARK), ((6.375, 0.0, 0.62), (0.03, 2.2, 0.34), DARK),
        ((6.39, 0.0, 0.55), (0.02, 0.52, 0.11), PLATE), ((6.38, 0.90, 0.70), (0.035, 0.34, 0.18), HEADLAMP),
        ((6.36, 1.10, 0.70), (0.06, 0.10, 0.16), SIGNAL), ((6.16, 1.315, 2.15), (0.13, 0.15, 0.60), DARK),
        ((6.16, 1.25, 2.38), (0.05, 0.16, 0.04), DARK), ((2.05, 1.18, 0.72), (2.3, 0.03, 0.12), METAL),
        ((2.05, 1.18, 0.48), (2.3, 0.03, 0.12), METAL), ((0.0, 1.02, 1.00), (1.15, 0.42, 0.03), DARK),
    )  # fmt: skip
    spoiler = [
        [(4.35, -1.05, 2.85), (5.95, -1.05, 2.85), (5.95, 1.05, 2.85), (4.35, 1.05, 2.85)],
        [(4.35, -1.0, 3.42), (4.75, -0.95, 3.42), (4.75, 0.95, 3.42), (4.35, 1.0, 3.42)],
    ]
    tank = cylinder((1.20, 0.62, 0.72), (2.50, 0.62, 0.72), 0.30, METAL, sides=14).moved((0.55, 0.35, -0.02))
    cab = Hull(SHAPES["truck"], stations, levels, 0.56)
    parts = [
        cab.mesh(PAINT),
        rear_wheels("truck", twin=True),
        cylinder((0, -0.99, 0.48), (0, 0.99, 0.48), 0.09, DARK, sides=8),
        cylinder((4.8, -0.99, 0.48), (4.8, 0.99, 0.48), 0.07, DARK, sides=8),
        *_boxes(*boxes),
        loft(spoiler, PAINT),
        screen((6.325, 1.06, 1.66), (6.235, 1.0, 2.60), GLASS, thickness=0.035),
        both_sides(tank),
    ]
    window = [(5.25, 1.66), (6.20, 1.66), (6.12, 2.48), (5.25, 2.48)]
    for side in (-1, 1):
        parts.append(cab.side_panel(window, side, GLASS, thickness=0.02))
        parts += [cab.seam(x, low, 2.55, 0.02, side) for x, low in ((5.15, 1.12), (6.24, 0.55))]
        parts.append(cab.plate((5.28, 5.46), (1.46, 1.51), side, DARK, thickness=0.04))
    return merged(*parts)


def _bus() -> Mesh:
    """A town bus with doors on its right side."""
    shape = SHAPES["bus"]
    stations = (
        (-3.385, 1.22, 2.86), (-3.34, 1.27, 2.92), (0.0, 1.275, 2.94), (8.2, 1.275, 2.94), (8.46, 1.26, 2.88),
        (8.56, 1.23, 1.30), (8.585, 1.18, 1.0),
    )  # fmt: skip
    levels = ((0.30, 0.97), (0.42, 1.0), (1.15, 1.0), (2.55, 0.975), (2.80, 0.94), (2.94, 0.82))
    boxes = (
        ((2.2, 0.0, 3.0), (3.0, 1.7, 0.20), METAL), ((-1.6, 0.0, 2.99), (1.6, 1.5, 0.16), METAL),
        ((-3.38, 0.0, 0.95), (0.03, 1.5, 0.50), DARK), ((-3.385, 0.0, 0.56), (0.03, 0.52, 0.11), PLATE_YELLOW),
        ((8.585, 0.0, 0.50), (0.03, 0.52, 0.11), PLATE), ((8.575, 0.0, 0.40), (0.04, 1.9, 0.16), DARK),
        ((8.575, 0.90, 0.78), (0.045, 0.40, 0.20), HEADLAMP), ((-3.375, 1.08, 1.05), (0.05, 0.16, 0.60), TAIL_LAMP),
        ((-3.375, 1.08, 1.46), (0.05, 0.16, 0.16), SIGNAL), ((8.36, 1.375, 2.10), (0.13, 0.13, 0.50), DARK),
        ((8.36, 1.30, 2.40), (0.06, 0.26, 0.05), DARK),
    )  # fmt: skip
    hull = Hull(shape, stations, levels, 0.55)
    display = Material("destination display", (0.95, 0.62, 0.10), 0.2)
    parts = [
        hull.mesh(PAINT),
        underbody(shape, 0.28, 0.72, 1.05),
        rear_wheels("bus", twin=True),
        *_boxes(*boxes),
        screen((8.545, 1.12, 1.10), (8.485, 1.08, 2.42), GLASS, thickness=0.07),
        screen((8.475, 0.95, 2.50), (8.462, 0.92, 2.80), DARK, thickness=0.05),
        screen((8.497, 0.75, 2.57), (8.488, 0.75, 2.74), display, thickness=0.012),
        screen((-3.385, -0.95, 1.60), (-3.385, -0.90, 2.50), GLASS, thickness=0.016),
    ]
    doors = ((6.85, 8.15), (2.35, 3.65))
    for side in (-1, 1):
        for low, high in pairwise(np.linspace(-3.20, 8.25, 9)):
            if side < 0 and any(low < far - 0.15 and high > near + 0.15 for near, far in doors):
                continue
            parts.append(hull.plate((low + 0.04, high - 0.04), (1.32, 2.46), side, GLASS, thickness=0.02))
        parts.append(hull.plate((-3.28, 8.40), (1.26, 2.52), side, DARK, thickness=0.012))
    for near, far in doors:
        middle = (near + far) / 2
        parts.append(hull.plate((near, far), (0.36, 2.50), -1, DARK, thickness=0.03))
        for low, high in ((near + 0.06, middle - 0.04), (middle + 0.04, far - 0.06)):
            parts.append(hull.plate((low, high), (0.50, 2.42), -1, GLASS, thickness=0.045))
    return merged(*parts)
