"""A town bus in the base frame (below the rear axle), without its front wheels."""

from itertools import pairwise

import numpy as np

from bags.simulator.world.bodies.chassis import rear_wheels, underbody
from bags.simulator.world.bodies.dimensions import SHAPES
from bags.simulator.world.bodies.hulls import Hull, both_sides, screen
from bags.simulator.world.meshes.materials import (
    DARK,
    GLASS,
    HEADLAMP,
    METAL,
    PLATE,
    PLATE_YELLOW,
    SIGNAL,
    TAIL_LAMP,
    paint,
)
from bags.simulator.world.meshes.mesh import Material, Mesh, Rgb, box, merged

__all__ = ["bus"]


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
