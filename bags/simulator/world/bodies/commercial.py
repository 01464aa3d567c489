"""Vans, trucks and buses in the base frame (below the rear axle), without their front wheels."""

from itertools import pairwise

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
from lidcam.bags.simulator.world.bodies.hulls import Hull, both_sides, rear_wheels, screen, underbody
from lidcam.bags.simulator.world.mesh import (
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
