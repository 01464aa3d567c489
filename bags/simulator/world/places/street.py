"""A town street along x with parking lanes, pavements, rows of houses, and a side road at x = 60."""

from collections.abc import Sequence

import numpy as np

from lidcam.bags.simulator.world.mesh import Material, Mesh, Rgb, Texture, box, merged, polygon, prism
from lidcam.bags.simulator.world.places import furniture
from lidcam.bags.simulator.world.places.furniture import BAY_M, KERB, KERB_M
from lidcam.pipeline.core.arrays import F64

FROM_M, TO_M = -150.0, 250.0
ROAD_M, PAVEMENT_M = 5.8, 8.8  # from the middle line to the kerb and to the front gardens
SIDE_X_M, SIDE_ROAD_M, SIDE_PAVEMENT_M, SIDE_FAR_M = 60.0, 3.5, 6.0, 70.0
CORNER_M = 2.2  # chamfer of the kerb at the side road

GROUND = Material("street ground", (0.35, 0.35, 0.36), 0.18, texture="street")
PAVING = Material("paving", (0.55, 0.53, 0.51), 0.35, texture="paving")
GARDEN_WALL = Material("garden wall", (0.56, 0.33, 0.26), 0.35, texture="brick")

WALLS: Sequence[Rgb] = (
    (0.82, 0.77, 0.66), (0.66, 0.42, 0.34), (0.78, 0.78, 0.74), (0.74, 0.60, 0.44), (0.60, 0.64, 0.66),
    (0.86, 0.82, 0.72), (0.58, 0.36, 0.30), (0.76, 0.68, 0.60),
)  # fmt: skip


def street() -> Mesh:
    """The static mesh of the street."""
    ground = polygon([(-260, -160, 0.0), (360, -160, 0.0), (360, 160, 0.0), (-260, 160, 0.0)], GROUND)
    parts = [ground]
    for side in (1, -1):
        parts += [*_pavements(side), *_houses(side), *_beside_pavement(side)]
    return merged(*parts)


def street_height(xy: F64) -> F64:
    """Heights (N,) of the ground at positions (N, 2); pavements are higher than roads and gardens."""
    x, beside = xy[:, 0], np.abs(xy[:, 1])
    off = np.abs(x - SIDE_X_M)
    outside = (x < FROM_M) | (x > TO_M) | (beside > SIDE_FAR_M) | (beside < ROAD_M) | (off < SIDE_ROAD_M)
    corner = (beside - ROAD_M) + (off - SIDE_ROAD_M) < CORNER_M
    paved = np.where(off < SIDE_PAVEMENT_M, ~corner, beside < PAVEMENT_M)
    return np.where(paved & ~outside, KERB_M, 0.0)


def _pavements(side: int) -> list[Mesh]:
    """Slabs and kerb stones on both sides of the side road."""
    inner, outer, stone, near, far = ROAD_M, PAVEMENT_M, 0.16, SIDE_ROAD_M, SIDE_PAVEMENT_M
    parts = []
    for end, length in ((-1, SIDE_X_M - FROM_M), (1, TO_M - SIDE_X_M)):
        edge, cut = inner + stone, CORNER_M
        slabs = [
            [(near + cut, edge), (length, edge), (length, outer), (near + stone, outer), (near + stone, inner + cut)],
            [(near + stone, outer), (far, outer), (far, SIDE_FAR_M), (near + stone, SIDE_FAR_M)],
        ]
        stones = [
            [(near + cut, inner), (length, inner), (length, edge), (near + cut, edge)],
            [(near, inner + cut), (near + stone, inner + cut), (near + stone, SIDE_FAR_M), (near, SIDE_FAR_M)],
            [(near + cut, inner), (near + cut, edge), (near + stone, inner + cut), (near, inner + cut)],
        ]
        for rows, top, look in ((slabs, KERB_M - 0.003, PAVING), (stones, KERB_M, KERB)):
            for row in rows:
                outline = np.array(row) * [end, side] + [SIDE_X_M, 0.0]
                parts.append(prism(outline if end * side > 0 else outline[::-1], -0.05, top, look))
    return parts


def _houses(side: int) -> list[Mesh]:
    """Rows of houses on a grid of facade bays, with some gaps and none at the side road."""
    draw = np.random.Generator(np.random.PCG64(31 + side))
    parts, bay = [], int(np.ceil((FROM_M + 2) / BAY_M))
    while bay * BAY_M < TO_M - 16:
        width, depth, storeys = (int(draw.integers(low, high)) for low, high in ((4, 7), (4, 6), (2, 5)))
        wall, roof = WALLS[int(draw.integers(len(WALLS)))], int(draw.integers(3))
        gap = int(draw.random() < 0.3) * 2
        low, high = bay * BAY_M, (bay + width) * BAY_M
        bay += width + gap
        if low < SIDE_X_M + 7.5 and high > SIDE_X_M - 7.5:
            bay = int(np.ceil((SIDE_X_M + 7.5) / BAY_M))
            continue
        front, back = 4 * BAY_M, (4 + depth) * BAY_M
        texture: Texture = "glass_front" if storeys == 4 and gap else "facade"
        corners = (low, min(side * front, side * back)), (high, max(side * front, side * back))
        flat = texture == "glass_front"
        parts.append(furniture.house(*corners, 2.9 * storeys + 0.1, wall, texture=texture, roof=None if flat else roof))
    # More houses along the side road.
    for k in range(3):
        y = sorted((side * (24.0 + 14.0 * k), side * (31.8 + 14.0 * k)))
        for end in (-1, 1):
            x = sorted((SIDE_X_M + end * 3.5 * BAY_M, SIDE_X_M + end * 7.5 * BAY_M))
            colors = WALLS[(3 * k + side + end) % len(WALLS)]
            parts.append(
                furniture.house((x[0], y[0]), (x[1], y[1]), 8.8, colors, roof=(k + end) % 3, ridge_along_x=False)
            )
    return parts


def _beside_pavement(side: int) -> list[Mesh]:
    """Trees and lamps at the kerb, walls and hedges of front gardens, signs, benches, bins."""
    parts = []
    kerb, garden = side * (ROAD_M + 0.7), side * (PAVEMENT_M + 0.25)
    for k, x in enumerate(np.arange(FROM_M + 10, TO_M, 20.0).tolist()):
        if abs(x - SIDE_X_M) < 11:
            continue
        if (k + (side > 0)) % 2:
            parts.append(furniture.lamp_post(x, kerb, 7.0, yaw=-side * np.pi / 2, reach=1.6))
        else:
            parts.append(furniture.tree(x, kerb, 6.0 + (k * 7 % 5) * 0.5))
        low, high = x + 2.0, x + 11.0
        if abs((low + high) / 2 - SIDE_X_M) > 13:
            if (k + side) % 3:
                edges = sorted((garden, garden + side * 0.3))
                parts.append(box(((low + high) / 2, sum(edges) / 2, 0.45), (high - low, 0.3, 0.9), GARDEN_WALL))
            else:
                edges = sorted((garden, garden + side * 0.7))
                parts.append(furniture.hedge((low, edges[0]), (high, edges[1]), 1.25))
    back = side * np.pi / 2
    ahead = 0.0 if side > 0 else np.pi  # signs face the oncoming traffic
    parts += [
        furniture.triangle_sign(SIDE_X_M - side * 4.3, side * (ROAD_M + 3.2), yaw=back),
        furniture.round_sign(SIDE_X_M + side * 14.0, kerb, yaw=ahead),
        furniture.round_sign(SIDE_X_M - side * 100.0, kerb, yaw=ahead, blue=True),
        furniture.traffic_light(SIDE_X_M + side * 8.2, kerb, yaw=ahead),
        furniture.bench(22.0, side * (PAVEMENT_M - 0.6), yaw=-back),
        furniture.litter_bin(23.6, side * (PAVEMENT_M - 0.5)),
        furniture.litter_bin(-47.0, side * (ROAD_M + 0.6)),
    ]
    return parts
