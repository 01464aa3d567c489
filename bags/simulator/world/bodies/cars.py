"""Passenger cars, full-size and model, in the base frame (below the rear axle), without their front wheels."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
from lidcam.bags.simulator.world.bodies.hulls import Hull, both_sides, rear_wheels, underbody
from lidcam.bags.simulator.world.mesh import (
    CHROME,
    DARK,
    GLASS,
    HEADLAMP,
    PLATE,
    PLATE_YELLOW,
    SEAM,
    TAIL_LAMP,
    Material,
    Mesh,
    Rgb,
    box,
    loft,
    merged,
    paint,
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
