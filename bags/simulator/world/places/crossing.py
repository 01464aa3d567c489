"""A full-size urban crossing: two roads along x and y, pavements, sensor masts, traffic lights, houses, trees.

The masts at (+-9.5, +-9.5) end at `MAST_TOP_M`; sensors sit above them or off their axis.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.bags.simulator.world.mesh import METAL, Material, Mesh, Rgb, Texture, box, cylinder, merged, polygon, prism
from lidcam.bags.simulator.world.places import furniture
from lidcam.bags.simulator.world.places.furniture import BAY_M, KERB, KERB_M
from lidcam.pipeline.core.arrays import F64

MAST_TOP_M = 5.8
FAR_M = 90.0
ROAD_M, PAVEMENT_M = 7.0, 11.0  # from the middle line to the kerb and to the lawn
CORNER_M = 3.5  # radius of the kerb at a corner

GROUND = Material("crossing ground", (0.35, 0.35, 0.36), 0.18, texture="crossing")
PAVING = Material("paving", (0.56, 0.54, 0.51), 0.35, texture="paving")
MAST = Material("mast", (0.50, 0.52, 0.54), 0.40, mirror=0.04)
CABINET = Material("switch cabinet", (0.58, 0.60, 0.56), 0.45)

House = tuple[tuple[int, int], tuple[int, int], float, Rgb, Texture, int | None, bool]

# By quarter, in facade bays from the middle: corners, height, wall, texture, roof, ridge along x.
HOUSES: Sequence[Sequence[House]] = (
    (
        ((6, 6), (14, 13), 17.4, (0.62, 0.64, 0.66), "glass_front", None, True),
        ((17, 6), (23, 10), 11.7, (0.80, 0.74, 0.62), "facade", 0, True),
        ((25, 6), (32, 10), 8.8, (0.72, 0.52, 0.42), "facade", 1, True),
        ((6, 17), (10, 23), 11.7, (0.78, 0.77, 0.72), "facade", 2, False),
        ((6, 25), (11, 31), 8.8, (0.60, 0.34, 0.27), "brick", 2, False),
    ),
    (
        ((7, 7), (12, 12), 8.8, (0.84, 0.80, 0.70), "facade", 1, True),
        ((14, 6), (21, 10), 11.7, (0.70, 0.72, 0.70), "facade", 0, True),
        ((24, 6), (31, 11), 14.6, (0.66, 0.60, 0.52), "facade", None, True),
        ((6, 15), (10, 21), 11.7, (0.62, 0.42, 0.34), "facade", 0, False),
        ((6, 24), (10, 32), 11.7, (0.80, 0.72, 0.56), "facade", 1, False),
    ),
    (
        ((6, 7), (12, 12), 11.7, (0.74, 0.62, 0.48), "facade", 0, False),
        ((15, 7), (22, 11), 8.8, (0.82, 0.80, 0.76), "facade", 2, True),
        ((25, 7), (32, 11), 11.7, (0.62, 0.66, 0.70), "facade", 0, True),
        ((7, 15), (11, 23), 14.6, (0.55, 0.57, 0.58), "glass_front", None, True),
        ((7, 26), (11, 32), 8.8, (0.78, 0.66, 0.52), "facade", 1, False),
    ),
    (
        ((12, 12), (20, 16), 8.8, (0.80, 0.78, 0.74), "facade", 1, True),
        ((24, 7), (31, 12), 11.7, (0.66, 0.46, 0.38), "facade", 0, True),
        ((7, 24), (12, 31), 11.7, (0.76, 0.74, 0.64), "facade", 0, False),
    ),
)
QUARTERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


def crossing() -> Mesh:
    """The static mesh of the crossing."""
    far = FAR_M + 60
    ground = polygon([(-far, -far, 0.0), (far, -far, 0.0), (far, far, 0.0), (-far, far, 0.0)], GROUND)
    parts = [ground]
    for number, (sx, sy) in enumerate(QUARTERS):
        parts += [*_pavement(sx, sy), *_mast(sx, sy), *_greenery(sx, sy, number), *_equipment(sx, sy)]
        for (x0, y0), (x1, y1), height, wall, texture, roof, along in HOUSES[number]:
            xs, ys = sorted((sx * x0 * BAY_M, sx * x1 * BAY_M)), sorted((sy * y0 * BAY_M, sy * y1 * BAY_M))
            corners = (xs[0], ys[0]), (xs[1], ys[1])
            parts.append(furniture.house(*corners, height, wall, texture=texture, roof=roof, ridge_along_x=along))
    return merged(*parts)


def crossing_height(xy: F64) -> F64:
    """Heights (N,) of the ground at positions (N, 2); pavements are higher than roads and lawns."""
    near, far = np.sort(np.abs(xy), axis=1).T
    middle = ROAD_M + CORNER_M
    before_arc = (far < middle) & (np.hypot(near - middle, far - middle) > CORNER_M)
    return np.where((near > ROAD_M) & (near < PAVEMENT_M) & (far < FAR_M) & ~before_arc, KERB_M, 0.0)


def _mirrored(outline: Sequence[tuple[float, float]], sx: int, sy: int) -> F64:
    """An outline of the first quarter mirrored into another one, still counter-clockwise."""
    turned = np.array(outline, np.float64) * [sx, sy]
    return turned if sx * sy > 0 else turned[::-1]


def _pavement(sx: int, sy: int) -> list[Mesh]:
    """Kerb stones around the corner, and slabs behind them."""
    inner, outer, middle, stone = ROAD_M, PAVEMENT_M, ROAD_M + CORNER_M, 0.16
    angles = np.linspace(np.pi, 1.5 * np.pi, 9)

    def arc(radius: float) -> list[tuple[float, float]]:
        return [(middle + radius * float(np.cos(a)), middle + radius * float(np.sin(a))) for a in angles]

    edge = inner + stone
    slabs = [
        [(edge, middle), *arc(CORNER_M - stone)[1:-1], (middle, edge), (outer, edge), (outer, outer), (edge, outer)],
        [(outer, edge), (FAR_M, edge), (FAR_M, outer), (outer, outer)],
        [(edge, outer), (outer, outer), (outer, FAR_M), (edge, FAR_M)],
    ]
    stones = [
        [(middle, inner), (FAR_M, inner), (FAR_M, edge), (middle, edge)],
        [(inner, middle), (edge, middle), (edge, FAR_M), (inner, FAR_M)],
    ]
    outside, inside = arc(CORNER_M), arc(CORNER_M - stone)
    stones += [[outside[i], outside[i + 1], inside[i + 1], inside[i]] for i in range(len(angles) - 1)]
    return [
        *(prism(_mirrored(slab, sx, sy), -0.05, KERB_M - 0.003, PAVING) for slab in slabs),
        *(prism(_mirrored(row, sx, sy), -0.05, KERB_M, KERB) for row in stones),
    ]


def _mast(sx: int, sy: int) -> list[Mesh]:
    x, y = 9.5 * sx, 9.5 * sy
    return [
        cylinder((x, y, 0.0), (x, y, MAST_TOP_M), 0.10, MAST, sides=14, taper=0.7),
        cylinder((x, y, KERB_M), (x, y, KERB_M + 0.03), 0.26, METAL, sides=14),
        box((x - 0.16 * sx, y, 1.6), (0.22, 0.34, 0.50), CABINET),
    ]


def _equipment(sx: int, sy: int) -> list[Mesh]:
    """Traffic lights for the incoming lanes beside this quarter, lamps, a cabinet, a bench, a bin."""
    to_road = np.pi if sx > 0 else 0.0
    parts = [
        box((14.0 * sx, 10.55 * sy, 0.72), (1.1, 0.42, 1.20), CABINET),
        furniture.litter_bin(10.4 * sx, 13.0 * sy),
        furniture.bench(10.3 * sx, 22.0 * sy, yaw=to_road),
        *(furniture.lamp_post(far * sx, 7.7 * sy, 8.0, yaw=-sy * np.pi / 2, reach=2.2) for far in (33.0, 66.0)),
        *(furniture.lamp_post(7.7 * sx, far * sy, 8.0, yaw=to_road, reach=2.2) for far in (33.0, 66.0)),
    ]
    # Incoming traffic along x keeps to y > 0 on the arm x > 0, and to y < 0 on the other.
    if sx * sy > 0:
        parts.append(furniture.traffic_light(12.2 * sx, 7.5 * sy, yaw=0.0 if sx > 0 else np.pi))
        parts.append(furniture.round_sign(40.0 * sx, 7.6 * sy, yaw=0.0 if sx > 0 else np.pi))
    else:
        parts.append(furniture.traffic_light(7.5 * sx, 12.2 * sy, yaw=sy * np.pi / 2))
        parts.append(furniture.round_sign(7.6 * sx, 40.0 * sy, yaw=sy * np.pi / 2, blue=True))
    return parts


def _greenery(sx: int, sy: int, number: int) -> list[Mesh]:
    """Trees along both roads, hedges in front of houses, a small park in the last quarter."""
    parts, heights = [], (7.5, 9.0, 6.5, 8.2, 7.0)
    places = [(19.0 + 15.0 * k, 12.9) for k in range(5)] + [(12.9, 21.0 + 15.5 * k) for k in range(5)]
    for row, (x, y) in enumerate(places, number):
        if row % 4:
            parts.append(furniture.tree(x * sx, y * sy, heights[row % 5]))
    low, high = sorted((34.0 * sx, 58.0 * sx)), sorted((13.9 * sy, 14.7 * sy))
    parts.append(furniture.hedge((low[0], high[0]), (low[1], high[1]), 1.1))
    if number == 3:
        park = [(15.0, 16.0, 8.5), (21.0, 18.5, 9.5), (16.5, 24.0, 7.5), (24.0, 25.0, 9.0), (15.5, 32.0, 8.0)]
        parts += [furniture.tree(x * sx, y * sy, height) for x, y, height in park]
        benches = (14.0, 19.5, np.pi), (18.5, 14.3, np.pi / 2)
        parts += [furniture.bench(x * sx, y * sy, yaw=yaw) for x, y, yaw in benches]
    return parts
