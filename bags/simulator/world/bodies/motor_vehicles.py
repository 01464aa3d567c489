"""Cars (full-size and model), vans, trucks and buses in the base frame (below the rear axle), without front wheels."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
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
    Rgb,
    box,
    cylinder,
    loft,
    merged,
    paint,
    panel,
)

INTERIOR = Material("interior", (0.18, 0.17, 0.17), 0.15)


BODIES: Mapping[str, tuple[Sequence[float], Sequence[float]]] = {
    "saloon": ((0.15, 0.30, 0.665, 0.725), (0.22, 0.32, 0.535, 0.575)),
    "estate": ((0.025, 0.23, 0.665, 0.725), (0.05, 0.22, 0.535, 0.575)),
    "mpv": ((0.025, 0.23, 0.72, 0.82), (0.06, 0.22, 0.60, 0.66)),
}
"""Shares of the length where a body has the rows of a hatchback's windows: at the belt line, and at the roof."""
BELT_ROWS, ROOF_ROWS = (0.03, 0.245, 0.665, 0.725), (0.11, 0.265, 0.535, 0.575)  # of the hatchback


def _passenger_car(
    name: str, color: Rgb, *, arch: float, mirror_half: float, inset: float, width: float, body_name: str = "hatchback"
) -> Mesh:
    """A car that fills the box of its shape, rear wheels included.

    In metres: the radius of the wheel arches, the distance of the mirrors' outer ends from the middle plane, half the
    width of the floor between the wheels, and the width of the body.
    """
    shape = SHAPES[name]
    body, half = paint(color), width / 2
    low, length, height = shape.bottom_m, shape.size_m[0], shape.size_m[2]

    def x(share: float) -> float:
        return shape.rear_m + share * length

    def z(share: float) -> float:
        return low + share * height

    hull = Hull(
        stations=(
            (x(0.004), 0.84 * half, z(0.56)),
            (x(0.012), 0.93 * half, z(0.61)),
            (x(0.05), 0.98 * half, z(0.645)),
            (x(0.14), half, z(0.655)),
            (x(0.68), half, z(0.635)),
            (x(0.74), half, z(0.62)),
            (x(0.90), 0.97 * half, z(0.545)),
            (x(0.950), 0.93 * half, z(0.505)),
            (x(0.980), 0.86 * half, z(0.460)),
            (x(0.994), 0.74 * half, z(0.41)),
        ),
        levels=(
            (z(0.13), 0.94),
            (z(0.20), 0.985),
            (z(0.36), 1.0),
            (z(0.53), 0.985),
            (z(0.60), 0.95),
            (z(0.65), 0.86),
        ),
        bottom_m=z(0.13),
        axles_m=(0.0, shape.wheel_base_m),
        arch_m=arch,
        axle_height_m=shape.wheel_radius_m,
    )
    parts = [
        hull.mesh(body, below=DARK),
        _car_cabin(x, z, half, body, body_name),
        box((x(0.45), 0.0, z(0.50)), (0.42 * length, 1.2 * half, 0.36 * height), INTERIOR),
        underbody(shape, z(0.14), inset, z(0.45)),
        rear_wheels(name),
    ]
    thin, wide = 0.006 * length, 0.29 * width
    deep = 0.8 * thin
    front, rear = x(1.0) - deep, x(0.0) + deep
    parts += [
        box((front, 0.0, z(0.215)), (deep, 1.05 * half, 0.13 * height), DARK),
        box((front, 0.0, z(0.375)), (deep, 0.90 * half, 0.045 * height), DARK),
        box((x(1.0) - 0.5 * thin, 0.0, z(0.275)), (thin, wide, 0.075 * height), PLATE),
        box((x(0.0) + 0.5 * thin, 0.0, z(0.40)), (thin, wide, 0.075 * height), PLATE_YELLOW),
        box((rear, 0.0, z(0.20)), (deep, 1.3 * half, 0.11 * height), DARK),
        both_sides(box((front, 0.60 * half, z(0.365)), (deep, 0.24 * half, 0.075 * height), HEADLAMP)),
        both_sides(box((front, 0.62 * half, z(0.21)), (deep, 0.12 * half, 0.06 * height), HEADLAMP)),
        both_sides(box((rear, 0.72 * half, z(0.485)), (deep, 0.24 * half, 0.13 * height), TAIL_LAMP)),
    ]
    for side in (-1, 1):
        lamp = [(x(0.952), z(0.365)), (x(0.993), z(0.328)), (x(0.993), z(0.402)), (x(0.952), z(0.43))]
        tail = [(x(0.006), z(0.42)), (x(0.04), z(0.44)), (x(0.04), z(0.55)), (x(0.006), z(0.55))]
        parts += [
            hull.side_panel(lamp, side, HEADLAMP, thickness=0.03 * width),
            hull.side_panel(tail, side, TAIL_LAMP, thickness=0.02 * width),
            hull.plate((x(0.31), x(0.71)), (z(0.135), z(0.185)), side, DARK, thickness=0.02 * width),
        ]
    parts.append(both_sides(_mirror(x(0.655), z(0.625), hull.half_width(x(0.655), z(0.60)), mirror_half, height, body)))
    seam = 0.003 * length
    for side in (-1, 1):
        parts += [hull.seam(x(share), z(0.19), z(0.62), seam, side, SEAM) for share in (0.655, 0.43)]
        parts.append(hull.seam(x(0.245), z(0.42), z(0.62), seam, side, SEAM))
    for share in (0.455, 0.275):
        ends = x(share), x(share + 0.035)
        heights = z(0.555), z(0.572)
        parts += [hull.plate(ends, heights, side, CHROME, thickness=0.018 * width) for side in (-1, 1)]
    return merged(*parts)


def _car_cabin(
    x: Callable[[float], float], z: Callable[[float], float], half: float, body: Material, body_name: str
) -> Mesh:
    """Windows all round, pillars and a roof."""
    # From the rear right corner forward: shares of length and half width at the belt line, the same at the roof, and
    # whether the strip up to the next row is glass.
    outline = (
        (0.030, 0.70, 0.110, 0.54, False),
        (0.055, 0.84, 0.125, 0.62, False),
        (0.135, 0.86, 0.165, 0.66, True),
        (0.245, 0.87, 0.265, 0.67, True),
        (0.43, 0.88, 0.43, 0.67, False),
        (0.455, 0.88, 0.45, 0.67, True),
        (0.63, 0.87, 0.535, 0.66, False),
        (0.665, 0.86, 0.55, 0.64, True),
        (0.725, 0.52, 0.575, 0.40, True),  # the windscreen
    )
    belt, roof = [row[:2] for row in outline], [row[2:4] for row in outline]
    if body_name in BODIES:
        belt_rows, roof_rows = BODIES[body_name]
        belt = [(float(np.interp(share, BELT_ROWS, belt_rows)), wide) for share, wide in belt]
        roof = [(float(np.interp(share, ROOF_ROWS, roof_rows)), wide) for share, wide in roof]
    glass = [row[4] for row in outline]
    strips = [*glass, *glass[-2::-1], True]  # the last one is the rear window

    def ring(points: list[tuple[float, float]], level: float, shrink: float) -> list[tuple[float, float, float]]:
        middle = x(0.33)
        right = [(middle + (x(a) - middle) * shrink, -half * b * shrink, z(level)) for a, b in points]
        return right + [(a, -b, c) for a, b, c in right[::-1]]

    def look(level: int, strip: int) -> Material:
        return GLASS if level == 1 and strips[strip] else body

    rings = [
        ring(belt, 0.60, 1.0),
        ring(belt, 0.655, 0.995),
        ring(roof, 0.945, 1.0),
        ring(roof, 0.982, 0.95),
        ring(roof, 1.0, 0.80),
    ]
    return loft(rings, body, where=look)


def _mirror(x: float, z: float, y: float, reach: float, height: float, body: Material) -> Mesh:
    """The left outside mirror, from the side of the body at `y` out to `reach`."""
    size = 0.085 * height
    inner = 0.94 * y
    shell = box((x, (inner + reach) / 2, z), (0.9 * size, reach - inner, size), body)
    glass = box((x - 0.46 * size, (y + reach) / 2, z), (0.06 * size, 0.8 * (reach - y), 0.8 * size), CHROME)
    return merged(shell, glass)


def model_car(color: Rgb) -> Mesh:
    """A model car at about 1:14, rear wheels included."""
    return _passenger_car("model_car", color, arch=0.0405, mirror_half=0.110, inset=0.060, width=0.206)


def car(color: Rgb, body: str = "hatchback") -> Mesh:
    """A full-size car, rear wheels included; `body` is one of `CarBody`."""
    return _passenger_car("car", color, arch=0.355, mirror_half=0.96, inset=0.55, width=1.80, body_name=body)


def van(color: Rgb) -> Mesh:
    """A panel van, rear wheels included."""
    shape, body = SHAPES["van"], paint(color)
    hull = Hull(
        stations=(
            (-1.09, 0.94, 2.44),
            (-1.07, 0.99, 2.49),
            (2.75, 1.0, 2.50),
            (3.00, 0.99, 2.46),
            (3.95, 0.98, 1.42),
            (4.10, 0.97, 1.34),
            (4.60, 0.92, 1.12),
            (4.74, 0.86, 0.98),
            (4.78, 0.78, 0.80),
        ),
        levels=((0.30, 0.95), (0.40, 0.99), (0.70, 1.0), (1.25, 0.99), (2.34, 0.91), (2.45, 0.86), (2.5, 0.76)),
        bottom_m=0.30,
        axles_m=(0.0, shape.wheel_base_m),
        arch_m=0.40,
        axle_height_m=shape.wheel_radius_m,
    )
    parts = [
        hull.mesh(body, below=DARK),
        underbody(shape, 0.28, 0.60, 0.80),
        rear_wheels("van"),
        screen((3.92, 0.88, 1.46), (3.05, 0.80, 2.40), GLASS, thickness=0.03),
        box((4.782, 0.0, 0.63), (0.024, 1.20, 0.20), DARK),
        box((4.782, 0.0, 0.39), (0.024, 1.40, 0.15), DARK),
        box((4.79, 0.0, 0.45), (0.02, 0.52, 0.11), PLATE),
        box((-1.095, 0.0, 0.62), (0.01, 0.52, 0.11), PLATE_YELLOW),
        box((-1.088, 0.0, 0.38), (0.012, 1.80, 0.16), DARK),
        box((-1.092, 0.0, 1.35), (0.012, 0.02, 1.8), SEAM),
        both_sides(box((4.782, 0.66, 0.69), (0.024, 0.18, 0.18), HEADLAMP)),
        both_sides(box((-1.085, 0.86, 1.05), (0.03, 0.13, 0.46), TAIL_LAMP)),
        both_sides(box((-1.085, 0.86, 1.36), (0.03, 0.12, 0.12), SIGNAL)),
        both_sides(
            panel(
                [(-1.09, 0.76, 1.45), (-1.09, 0.06, 1.45), (-1.09, 0.06, 2.15), (-1.09, 0.70, 2.15)],
                GLASS,
                thickness=0.012,
            )
        ),
        both_sides(box((3.62, 1.10, 1.62), (0.13, 0.14, 0.34), DARK)),
        both_sides(box((3.64, 1.02, 1.52), (0.06, 0.16, 0.05), DARK)),
    ]
    for side in (-1, 1):
        window = [(2.32, 1.46), (3.70, 1.46), (3.06, 2.20), (2.32, 2.20)]
        parts += [hull.side_panel(window, side, GLASS, thickness=0.03)]
        parts += [hull.seam(x, 0.42, top, 0.016, side, SEAM) for x, top in ((0.62, 2.3), (2.22, 2.3), (3.12, 1.44))]
        parts.append(hull.plate((0.50, 3.08), (0.58, 0.72), side, DARK, thickness=0.04))
        parts += [hull.plate((x, x + 0.16), (1.26, 1.30), side, DARK, thickness=0.05) for x in (2.36, 2.0)]
    return merged(*parts)


def truck(color: Rgb) -> Mesh:
    """A truck with a white box body behind a painted cab, rear wheels included."""
    shape, body = SHAPES["truck"], paint(color)
    white = Material("box body", (0.86, 0.87, 0.88), 0.62, mirror=0.02)
    cab = Hull(
        stations=(
            (4.25, 1.20, 2.86),
            (4.32, 1.235, 2.90),
            (5.95, 1.235, 2.90),
            (6.22, 1.22, 2.84),
            (6.34, 1.20, 1.55),
            (6.385, 1.14, 1.30),
        ),
        levels=((0.42, 0.96), (0.55, 1.0), (1.50, 1.0), (2.60, 0.95), (2.80, 0.90), (2.90, 0.80)),
        bottom_m=0.42,
        axles_m=(shape.wheel_base_m,),
        arch_m=0.56,
        axle_height_m=shape.wheel_radius_m,
    )
    parts = [
        cab.mesh(body, below=DARK),
        rear_wheels("truck", twin=True),
        cylinder((0, -0.99, 0.48), (0, 0.99, 0.48), 0.09, DARK, sides=8),
        cylinder((4.8, -0.99, 0.48), (4.8, 0.99, 0.48), 0.07, DARK, sides=8),
        both_sides(box((1.95, 0.42, 0.88), (8.1, 0.09, 0.24), METAL)),
        box((4.9, 0.0, 0.85), (2.3, 1.1, 0.5), DARK),
        box((0.90, 0.0, 2.255), (6.20, 2.50, 2.47), white),
        box((0.90, 0.0, 1.03), (6.18, 2.46, 0.10), METAL),
        both_sides(box((0.90, 1.253, 3.44), (6.20, 0.02, 0.10), METAL)),
        both_sides(box((0.90, 1.253, 1.10), (6.20, 0.02, 0.12), METAL)),
        both_sides(box((4.00, 1.235, 2.25), (0.06, 0.06, 2.46), METAL)),
        both_sides(box((-2.175, 1.235, 2.25), (0.05, 0.06, 2.46), METAL)),
        box((-2.195, 0.0, 2.25), (0.012, 0.03, 2.40), METAL),
        both_sides(box((-2.194, 0.35, 2.0), (0.012, 0.03, 1.8), METAL)),
        box((-2.12, 0.0, 0.55), (0.10, 2.30, 0.14), METAL),
        both_sides(box((-2.12, 0.50, 0.75), (0.08, 0.08, 0.40), METAL)),
        both_sides(box((-2.178, 0.95, 0.56), (0.03, 0.36, 0.12), TAIL_LAMP)),
        box((-2.18, 0.0, 0.55), (0.03, 0.52, 0.11), PLATE_YELLOW),
        loft(
            [
                [(4.35, -1.05, 2.85), (5.95, -1.05, 2.85), (5.95, 1.05, 2.85), (4.35, 1.05, 2.85)],
                [(4.35, -1.0, 3.42), (4.75, -0.95, 3.42), (4.75, 0.95, 3.42), (4.35, 1.0, 3.42)],
            ],
            body,
        ),
        screen((6.325, 1.06, 1.66), (6.235, 1.0, 2.60), GLASS, thickness=0.035),
        box((6.375, 0.0, 1.12), (0.03, 1.7, 0.36), DARK),
        box((6.375, 0.0, 0.62), (0.03, 2.2, 0.34), DARK),
        box((6.39, 0.0, 0.55), (0.02, 0.52, 0.11), PLATE),
        both_sides(box((6.38, 0.90, 0.70), (0.035, 0.34, 0.18), HEADLAMP)),
        both_sides(box((6.36, 1.10, 0.70), (0.06, 0.10, 0.16), SIGNAL)),
        both_sides(box((6.16, 1.315, 2.15), (0.13, 0.15, 0.60), DARK)),
        both_sides(box((6.16, 1.25, 2.38), (0.05, 0.16, 0.04), DARK)),
        both_sides(cylinder((1.20, 0.62, 0.72), (2.50, 0.62, 0.72), 0.30, METAL, sides=14).moved((0.55, 0.35, -0.02))),
        both_sides(box((2.05, 1.18, 0.72), (2.3, 0.03, 0.12), METAL)),
        both_sides(box((2.05, 1.18, 0.48), (2.3, 0.03, 0.12), METAL)),
        both_sides(box((0.0, 1.02, 1.00), (1.15, 0.42, 0.03), DARK)),
    ]
    for side in (-1, 1):
        window = [(5.25, 1.66), (6.20, 1.66), (6.12, 2.48), (5.25, 2.48)]
        parts.append(cab.side_panel(window, side, GLASS, thickness=0.02))
        parts += [cab.seam(x, low, 2.55, 0.02, side, SEAM) for x, low in ((5.15, 1.12), (6.24, 0.55))]
        parts.append(cab.plate((5.28, 5.46), (1.46, 1.51), side, DARK, thickness=0.04))
    return merged(*parts)


def bus(color: Rgb) -> Mesh:
    """A town bus with doors on its right side, rear wheels included."""
    shape, body = SHAPES["bus"], paint(color)
    hull = Hull(
        stations=(
            (-3.385, 1.22, 2.86),
            (-3.34, 1.27, 2.92),
            (0.0, 1.275, 2.94),
            (8.2, 1.275, 2.94),
            (8.46, 1.26, 2.88),
            (8.56, 1.23, 1.30),
            (8.585, 1.18, 1.0),
        ),
        levels=((0.30, 0.97), (0.42, 1.0), (1.15, 1.0), (2.55, 0.975), (2.80, 0.94), (2.94, 0.82)),
        bottom_m=0.30,
        axles_m=(0.0, shape.wheel_base_m),
        arch_m=0.55,
        axle_height_m=shape.wheel_radius_m,
    )
    display = Material("destination display", (0.95, 0.62, 0.10), 0.2)
    parts = [
        hull.mesh(body, below=DARK),
        underbody(shape, 0.28, 0.72, 1.05),
        rear_wheels("bus", twin=True),
        box((2.2, 0.0, 3.0), (3.0, 1.7, 0.20), METAL),
        box((-1.6, 0.0, 2.99), (1.6, 1.5, 0.16), METAL),
        screen((8.545, 1.12, 1.10), (8.485, 1.08, 2.42), GLASS, thickness=0.07),
        screen((8.475, 0.95, 2.50), (8.462, 0.92, 2.80), DARK, thickness=0.05),
        screen((8.497, 0.75, 2.57), (8.488, 0.75, 2.74), display, thickness=0.012),
        screen((-3.385, -0.95, 1.60), (-3.385, -0.90, 2.50), GLASS, thickness=0.016),
        box((-3.38, 0.0, 0.95), (0.03, 1.5, 0.50), DARK),
        box((-3.385, 0.0, 0.56), (0.03, 0.52, 0.11), PLATE_YELLOW),
        box((8.585, 0.0, 0.50), (0.03, 0.52, 0.11), PLATE),
        box((8.575, 0.0, 0.40), (0.04, 1.9, 0.16), DARK),
        both_sides(box((8.575, 0.90, 0.78), (0.045, 0.40, 0.20), HEADLAMP)),
        both_sides(box((-3.375, 1.08, 1.05), (0.05, 0.16, 0.60), TAIL_LAMP)),
        both_sides(box((-3.375, 1.08, 1.46), (0.05, 0.16, 0.16), SIGNAL)),
        both_sides(box((8.36, 1.375, 2.10), (0.13, 0.13, 0.50), DARK)),
        both_sides(box((8.36, 1.30, 2.40), (0.06, 0.26, 0.05), DARK)),
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
