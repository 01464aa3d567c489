"""Houses and street furniture: trees, lamps, signs, traffic lights, hedges, benches, bins."""

from collections.abc import Sequence
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.world.mesh import (
    DARK,
    METAL,
    Material,
    Mesh,
    Rgb,
    Texture,
    box,
    cylinder,
    loft,
    merged,
    sphere,
)
from lidcam.pipeline.core.arrays import F64

KERB_M = 0.12  # height of pavements above roads
BAY_M = 2.6  # width of a facade bay with one window: walls on multiples of it cut no window

BARK = Material("bark", (0.34, 0.27, 0.21), 0.35, texture="bark")
KERB = Material("kerb", (0.62, 0.61, 0.59), 0.40, texture="concrete")
LEAVES = tuple(
    Material(f"leaves {index}", rgb, 0.5, texture="foliage")
    for index, rgb in enumerate([(0.28, 0.42, 0.16), (0.35, 0.45, 0.18), (0.22, 0.37, 0.17)])
)
NEEDLES = Material("needles", (0.16, 0.30, 0.17), 0.45, texture="foliage")
HEDGE = Material("hedge", (0.20, 0.33, 0.15), 0.5, texture="foliage")
POLE = Material("galvanised pole", (0.55, 0.57, 0.58), 0.45, mirror=0.03)
LAMP = Material("lamp", (0.92, 0.91, 0.85), 0.7)
BRICK_CHIMNEY = Material("chimney", (0.50, 0.28, 0.22), 0.3, texture="brick")
SIGN_RED = Material("sign, red", (0.75, 0.08, 0.08), 2.0)
SIGN_BLUE = Material("sign, blue", (0.08, 0.25, 0.62), 2.0)
SIGN_WHITE = Material("sign, white", (0.95, 0.95, 0.93), 3.0)
SIGN_BACK = Material("sign, back", (0.50, 0.51, 0.52), 0.4)
LIGHTS = (
    Material("red light", (0.90, 0.12, 0.08), 0.6),
    Material("amber light", (0.45, 0.30, 0.05), 0.5),
    Material("green light", (0.05, 0.30, 0.15), 0.5),
)
BENCH_WOOD = Material("bench", (0.45, 0.31, 0.19), 0.3, texture="wood")
ROOFS = tuple(
    Material(f"roof {index}", rgb, 0.3, texture="roof")
    for index, rgb in enumerate([(0.52, 0.25, 0.18), (0.40, 0.23, 0.19), (0.33, 0.33, 0.35)])
)


def _generator(*place: float) -> np.random.Generator:
    """Random numbers seeded by position: independent of what else is built."""
    return np.random.Generator(np.random.PCG64(crc32(np.array(place, np.float64).tobytes())))


def tree(x: float, y: float, height: float) -> Mesh:
    """A deciduous tree: trunk, boughs, and a crown of irregular spheres."""
    draw = _generator(x, y, height)
    leaves = LEAVES[int(draw.integers(len(LEAVES)))]
    fork = 0.36 * height
    parts = [cylinder((x, y, 0.0), (x, y, fork), 0.022 * height, BARK, sides=8, taper=0.75)]
    turn = draw.uniform(0, 2 * np.pi)
    # Spheres: distance from the trunk, height and radius as shares of the tree's height; count.
    for spread, level, size, count in ((0.19, 0.54, 0.155, 5), (0.12, 0.72, 0.15, 3), (0.0, 0.84, 0.145, 1)):
        for number in range(count):
            angle = turn + 2 * np.pi * (number + level) / count
            middle = np.array([spread * np.cos(angle), spread * np.sin(angle), level]) + draw.uniform(-0.025, 0.025, 3)
            middle = np.array([x, y, 0.0]) + height * middle
            parts.append(cylinder((x, y, 0.9 * fork), middle, 0.010 * height, BARK, sides=4, taper=0.5))
            ball = sphere(middle, height * size * draw.uniform(0.9, 1.15), leaves, sides=10)
            parts.append(_crumpled(ball, middle, draw, strength=0.2))
    return merged(*parts)


def conifer(x: float, y: float, height: float, *, base: float = 0.0) -> Mesh:
    """A fir: three tiers on a trunk."""
    draw = _generator(x, y, height)
    parts = [cylinder((x, y, base), (x, y, base + 0.3 * height), 0.03 * height, BARK, sides=8)]
    for low, high, radius in ((0.14, 0.60, 0.24), (0.38, 0.82, 0.19), (0.62, 1.0, 0.13)):
        tier = cylinder(
            (x, y, base + low * height), (x, y, base + high * height), radius * height, NEEDLES, sides=11, taper=0.06
        )
        parts.append(_crumpled(tier, np.array([x, y, base + 0.5 * height]), draw, strength=0.06))
    return merged(*parts)


def _crumpled(mesh: Mesh, middle: F64, draw: np.random.Generator, *, strength: float = 0.13) -> Mesh:
    """The mesh with every vertex moved a little towards `middle` or away from it."""
    share = 1 + draw.uniform(-strength, strength, len(mesh.vertices))[:, None]
    return Mesh(middle + (mesh.vertices - middle) * share, mesh.triangles, mesh.materials, mesh.palette)


def house(
    low: Sequence[float],
    high: Sequence[float],
    height: float,
    wall: Rgb,
    *,
    texture: Texture = "facade",
    roof: int | None = 0,
    ridge_along_x: bool = True,
) -> Mesh:
    """A house between two corners on the ground, of the least and the greatest x and y.

    Height, colour and texture are those of the walls. The roof is a row of `ROOFS`, or None for a flat one with a
    parapet; the ridge of a pitched one runs along x or y.
    """
    size = np.subtract(high, low)
    middle = np.add(high, low) / 2
    walls = Material(f"wall {wall} {texture}", wall, 0.35 + 0.2 * float(np.mean(wall)), texture=texture)
    parts = [box((*middle, height / 2), (*size, height), walls)]
    if roof is None:
        coping = Material("coping", (0.55, 0.55, 0.54), 0.4, texture="concrete")
        for axis in (0, 1):
            for end in (-1, 1):
                place, length = middle.copy(), size + 0.1
                place[axis] += end * (size[axis] / 2 - 0.1)
                length[axis] = 0.3
                parts.append(box((*place, height + 0.2), (*length, 0.4), coping))
        plant = (0.25 * size[0], 0.3 * size[1], 1.6)
        return merged(*parts, box((*middle, height + 0.8), plant, POLE))
    across, along = (size[1], size[0]) if ridge_along_x else (size[0], size[1])
    half, eaves = across / 2 + 0.4, 0.35
    rise = 0.42 * across
    plaster = Material(f"gable {wall}", wall, walls.reflectivity, texture="concrete")
    ends = [[(x, y, z) for x, z in ((-half, 0.0), (half, 0.0), (0.0, rise))] for y in np.array([0.5, -0.5]) * along]
    gable = merged(  # Two slabs of tiles on a plastered body that ends with the walls.
        loft(ends, plaster), *(_roof_slab(side, half, rise, along + 2 * eaves, ROOFS[roof]) for side in (-1, 1))
    ).moved((*middle, height), yaw=np.pi / 2 if ridge_along_x else 0.0)
    chimney_at = middle + (np.array([0.3 * along, 0.15 * across]) if ridge_along_x else np.array([0.15, 0.3]) * size)
    chimney = box((*chimney_at, height + 0.75 * rise + 0.3), (0.7, 0.7, 0.9 * rise), BRICK_CHIMNEY)
    gutters = []
    for end in (-1, 1):
        offset = np.array([0.0, end * half]) if ridge_along_x else np.array([end * half, 0.0])
        bar = (along + 2 * eaves, 0.14, 0.12) if ridge_along_x else (0.14, along + 2 * eaves, 0.12)
        gutters.append(box((*(middle + offset), height + 0.02), bar, METAL))
    return merged(*parts, gable, chimney, *gutters)


def _roof_slab(side: int, half: float, rise: float, length: float, tiles: Material) -> Mesh:
    """One side of a pitched roof with its ridge along y, 12 cm thick."""
    section = [(0.0, rise), (side * half, 0.0), (side * half, 0.12), (0.0, rise + 0.12)]
    return loft([[(x, y, z) for x, z in section] for y in (-length / 2, length / 2)], tiles)


def lamp_post(x: float, y: float, height: float, *, yaw: float, reach: float = 1.4) -> Mesh:
    """A street lamp with its arm towards `yaw`."""
    out = np.array([np.cos(yaw), np.sin(yaw)]) * reach
    return merged(
        cylinder((x, y, 0.0), (x, y, 1.0), 0.09 * height / 7, POLE, sides=10),
        cylinder((x, y, 1.0), (x, y, height), 0.065 * height / 7, POLE, sides=10, taper=0.7),
        cylinder((x, y, height - 0.05), (x + out[0], y + out[1], height + 0.15), 0.035, POLE, sides=8),
        box((x + out[0], y + out[1], height + 0.15), (0.7, 0.28, 0.12), METAL, yaw=yaw),
        box((x + out[0], y + out[1], height + 0.085), (0.5, 0.2, 0.03), LAMP, yaw=yaw),
    )


def round_sign(x: float, y: float, *, yaw: float, blue: bool = False) -> Mesh:
    """A round traffic sign facing `yaw`."""
    look = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    middle = np.array([x, y, 2.35]) + 0.05 * look
    outer = SIGN_BLUE if blue else SIGN_RED
    layers = [(0.0, 0.30, SIGN_BACK), (0.012, 0.295, outer)] + ([] if blue else [(0.022, 0.22, SIGN_WHITE)])
    discs = [cylinder(middle + s * look, middle + (s + 0.012) * look, r, m, sides=20) for s, r, m in layers]
    if blue:
        discs.append(box(middle + 0.026 * look, (0.01, 0.09, 0.36), SIGN_WHITE, yaw=yaw))
    return merged(cylinder((x, y, 0.0), (x, y, 2.75), 0.03, POLE, sides=8), *discs)


def triangle_sign(x: float, y: float, *, yaw: float) -> Mesh:
    """A give-way sign facing `yaw`."""

    def plate(size: float, front: float, material: Material) -> Mesh:
        corners = np.array([(0.0, -0.5 * size), (0.5 * size, 0.36 * size), (-0.5 * size, 0.36 * size)])
        rings = [[(s, y0, z0 + 2.3) for y0, z0 in corners] for s in (front, front + 0.012)]
        return loft(rings, material).moved((x, y, 0.0), yaw=yaw)

    plates = [plate(0.9, 0.04, SIGN_BACK), plate(0.88, 0.052, SIGN_RED), plate(0.58, 0.064, SIGN_WHITE)]
    return merged(cylinder((x, y, 0.0), (x, y, 2.75), 0.03, POLE, sides=8), *plates)


def traffic_light(x: float, y: float, *, yaw: float) -> Mesh:
    """A traffic light facing `yaw`."""
    look = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    head = np.array([x, y, 2.95]) + 0.20 * look
    parts = [
        cylinder((x, y, 0.0), (x, y, 3.4), 0.06, POLE, sides=10),
        box(head, (0.22, 0.30, 0.92), DARK, yaw=yaw),
        box(head - 0.10 * look, (0.02, 0.46, 1.08), DARK, yaw=yaw),
    ]
    for number, light in enumerate(LIGHTS):
        lamp = head + np.array([0.0, 0.0, 0.28 - 0.28 * number])
        parts.append(cylinder(lamp + 0.11 * look, lamp + 0.125 * look, 0.10, light, sides=14))
        hood = lamp + np.array([0.0, 0.0, 0.115]) + 0.18 * look
        parts.append(box(hood, (0.16, 0.22, 0.015), DARK, yaw=yaw))
    return merged(*parts)


def hedge(low: Sequence[float], high: Sequence[float], height: float) -> Mesh:
    """A clipped hedge between two corners on the ground."""
    size, middle = np.subtract(high, low), np.add(high, low) / 2
    return box((*middle, height / 2), (*size, height), HEDGE)


def bench(x: float, y: float, *, yaw: float) -> Mesh:
    """A bench facing `yaw`."""
    slats = [box((0.0 + 0.13 * k, 0, 0.45), (0.11, 1.7, 0.04), BENCH_WOOD) for k in range(4)]
    back = [box((-0.10 - 0.03 * k, 0, 0.60 + 0.14 * k), (0.04, 1.7, 0.11), BENCH_WOOD) for k in range(3)]
    legs = [box((0.15, side * 0.7, 0.22), (0.5, 0.06, 0.44), METAL) for side in (-1, 1)]
    return merged(*slats, *back, *legs).moved((x, y, 0.0), yaw=yaw)


def litter_bin(x: float, y: float) -> Mesh:
    """A litter bin on a foot."""
    return merged(
        cylinder((x, y, 0.0), (x, y, 0.35), 0.04, METAL, sides=8),
        cylinder((x, y, 0.30), (x, y, 0.95), 0.19, Material("bin", (0.20, 0.30, 0.25), 0.3), sides=14, taper=1.1),
    )
