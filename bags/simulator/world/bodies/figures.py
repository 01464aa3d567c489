"""Parts that pedestrians and cyclists share: looks, head, thighs and shins; lengths in metres."""

from functools import cache
from typing import NamedTuple
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.world.meshes.lofts import ellipses, limb
from lidcam.bags.simulator.world.meshes.mesh import Material, Mesh, Rgb, merged, sphere

HIP_Y_M = 0.095
"""From the middle plane to the hip joint."""
SKIN = ((0.87, 0.70, 0.58), (0.76, 0.57, 0.43), (0.55, 0.38, 0.27), (0.91, 0.76, 0.66))
HAIR = ((0.16, 0.12, 0.10), (0.32, 0.22, 0.14), (0.55, 0.42, 0.26), (0.42, 0.41, 0.40))
TROUSERS = ((0.16, 0.19, 0.30), (0.14, 0.14, 0.15), (0.45, 0.40, 0.32), (0.28, 0.30, 0.32))
SHOES = Material("shoes", (0.18, 0.15, 0.14), 0.2)


class Looks(NamedTuple):
    """Materials of a person."""

    skin: Material
    hair: Material
    jacket: Material
    trousers: Material


def looks_of(name: str, color: Rgb) -> Looks:
    """The looks of a person, derived from the name, with a jacket of this colour."""
    number = crc32(name.encode())
    jacket = Material("jacket", color, 0.25 + 0.35 * float(np.mean(color)))
    return Looks(
        Material("skin", SKIN[number % 4], 0.45),
        Material("hair", HAIR[number // 4 % 4], 0.20),
        jacket,
        Material("trousers", TROUSERS[number // 16 % 4], 0.30),
    )


REFERENCE = looks_of("", (0.123, 0.456, 0.789))
"""The looks of bodies that are made once, to be recolored."""


def recolored(mesh: Mesh, looks: Looks) -> Mesh:
    """A body of `REFERENCE` looks with others."""
    return mesh.recolored(dict(zip(REFERENCE, looks, strict=True)))


def head(skin: Material, hair: Material, x: float, z: float) -> list[Mesh]:
    """Neck, head and hair, with the middle of the head at `x` and `z`."""
    return [
        ellipses([(z - 0.17, x - 0.01, 0, 0.052, 0.052), (z - 0.06, x - 0.01, 0, 0.055, 0.052)], skin),
        ellipses(
            [
                (z - 0.115, x + 0.025, 0, 0.045, 0.035),
                (z - 0.07, x + 0.015, 0, 0.080, 0.062),
                (z, x + 0.005, 0, 0.095, 0.073),
                (z + 0.07, x, 0, 0.090, 0.068),
                (z + 0.11, x, 0, 0.050, 0.040),
            ],
            skin,
            sides=12,
        ),
        ellipses(
            [
                (z - 0.07, x - 0.062, 0, 0.040, 0.055),
                (z - 0.01, x - 0.035, 0, 0.078, 0.080),
                (z + 0.055, x - 0.012, 0, 0.098, 0.080),
                (z + 0.10, x - 0.006, 0, 0.075, 0.060),
                (z + 0.12, x - 0.006, 0, 0.035, 0.030),
            ],
            hair,
            sides=12,
        ),
    ]


@cache
def thigh_mesh(length: float, trousers: Material) -> Mesh:
    """A thigh that hangs down from the hip at the origin."""
    return merged(
        limb([(0, 0, 0.02), (0, 0, -length)], (0.085, 0.060), trousers, sides=10),
        sphere((0, 0, -length), 0.060, trousers, sides=8),
    )


@cache
def shin_mesh(length: float, trousers: Material) -> Mesh:
    """A shin with a shoe that hangs down from the knee at the origin."""
    return merged(
        limb([(0, 0, 0), (-0.012, 0, -0.35 * length), (0, 0, -length)], (0.060, 0.062, 0.046), trousers, sides=10),
        ellipses(
            [
                (-length - 0.08, 0.055, 0, 0.120, 0.040),
                (-length - 0.055, 0.055, 0, 0.125, 0.046),
                (-length - 0.02, 0.035, 0, 0.095, 0.044),
                (-length + 0.03, 0.0, 0, 0.055, 0.050),
            ],
            SHOES,
            sides=12,
        ),
    )
