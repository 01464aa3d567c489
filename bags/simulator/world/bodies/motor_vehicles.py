"""Cars (full-size and model), vans, trucks and buses in the base frame (below the rear axle), without front wheels."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, Vector
from lidcam.bags.simulator.world.bodies.hulls import Hull, both_sides, rear_wheels, screen, underbody
from lidcam.bags.simulator.world.mesh import (
    CHROME,
    DARK,
    GLASS,
    HEADLAMP,
    METAL,
    PLATE,
    PLATE_YELLOW,
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
    """A panel van."""
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
