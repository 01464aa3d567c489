"""A panel van in the base frame (below the rear axle), without its front wheels."""

from bags.simulator.world.bodies.chassis import rear_wheels, underbody
from bags.simulator.world.bodies.dimensions import SHAPES
from bags.simulator.world.bodies.hulls import Hull, both_sides, screen
from bags.simulator.world.meshes.lofts import panel
from bags.simulator.world.meshes.materials import (
    DARK,
    GLASS,
    HEADLAMP,
    PLATE,
    PLATE_YELLOW,
    SEAM,
    SIGNAL,
    TAIL_LAMP,
    paint,
)
from bags.simulator.world.meshes.mesh import Mesh, Rgb, box, merged

__all__ = ["van"]


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
