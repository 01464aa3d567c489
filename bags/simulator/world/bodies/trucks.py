"""A truck in the base frame (below the rear axle), without its front wheels."""

from bags.simulator.world.bodies.chassis import rear_wheels
from bags.simulator.world.bodies.dimensions import SHAPES
from bags.simulator.world.bodies.hulls import Hull, both_sides, screen
from bags.simulator.world.meshes.lofts import loft
from bags.simulator.world.meshes.materials import (
    DARK,
    GLASS,
    HEADLAMP,
    METAL,
    PLATE,
    PLATE_YELLOW,
    SEAM,
    SIGNAL,
    TAIL_LAMP,
    paint,
)
from bags.simulator.world.meshes.mesh import Material, Mesh, Rgb, box, cylinder, merged

__all__ = ["truck"]


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
