"""A walking pedestrian in rigid parts (torso, thighs, shins with feet, arms), and what cyclists share with it.

The legs swing with the distance walked; the leg that reaches further down sets the height of the hips, so one foot is
always on the ground. Lengths are metres.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Literal, NamedTuple
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.world.mesh import Material, Mesh, Rgb, ellipses, limb, merged, sphere
from lidcam.bags.simulator.world.motion import SPEED, WALKED, ArticulatedPath, Carrier, Part, Poses, pitched
from lidcam.pipeline.core.arrays import F64

Limb = Literal["thigh", "shin", "arm"]

THIGH_M, SHIN_M = 0.43, 0.42
HEEL, TOE = (-0.061, -0.08), (0.171, -0.08)  # x and z from the ankle
SHOULDER_Y_M = 0.20
SHOULDER_ABOVE_HIP_M = 0.50
STRIDE_RAD, KNEE_RAD, ARM_RAD = 0.36, 0.95, 0.34
CYCLE_M = 1.28  # distance per cycle of both legs
FULL_STRIDE_M_S = 0.7  # from this speed on, steps have their full length
HIP_Y_M = 0.095  # from the middle plane to the hip joint
SKINS = ((0.87, 0.70, 0.58), (0.76, 0.57, 0.43), (0.55, 0.38, 0.27), (0.91, 0.76, 0.66))
HAIRS = ((0.16, 0.12, 0.10), (0.32, 0.22, 0.14), (0.55, 0.42, 0.26), (0.42, 0.41, 0.40))
TROUSER_COLORS = ((0.16, 0.19, 0.30), (0.14, 0.14, 0.15), (0.45, 0.40, 0.32), (0.28, 0.30, 0.32))
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
    skin, hair = Material("skin", SKINS[number % 4], 0.45), Material("hair", HAIRS[number // 4 % 4], 0.20)
    jacket = Material("jacket", color, 0.25 + 0.35 * float(np.mean(color)))
    return Looks(skin, hair, jacket, Material("trousers", TROUSER_COLORS[number // 16 % 4], 0.30))


REFERENCE = looks_of("", (0.123, 0.456, 0.789))
SKIN, HAIR, JACKET, TROUSERS = REFERENCE
"""The looks of all bodies, which are made once, to be recolored."""


def recolored(mesh: Mesh, looks: Looks) -> Mesh:
    """A body of `REFERENCE` looks with others."""
    return mesh.recolored(dict(zip(REFERENCE, looks, strict=True)))


def head(x: float, z: float) -> list[Mesh]:
    """Neck, head and hair, with the middle of the head at `x` and `z`."""
    neck = [(z - 0.17, x - 0.01, 0, 0.052, 0.052), (z - 0.06, x - 0.01, 0, 0.055, 0.052)]
    face = [
        (z - 0.115, x + 0.025, 0, 0.045, 0.035), (z - 0.07, x + 0.015, 0, 0.080, 0.062),
        (z, x + 0.005, 0, 0.095, 0.073), (z + 0.07, x, 0, 0.090, 0.068), (z + 0.11, x, 0, 0.050, 0.040),
    ]  # fmt: skip
    hair = [
        (z - 0.07, x - 0.062, 0, 0.040, 0.055), (z - 0.01, x - 0.035, 0, 0.078, 0.080),
        (z + 0.055, x - 0.012, 0, 0.098, 0.080), (z + 0.10, x - 0.006, 0, 0.075, 0.060),
        (z + 0.12, x - 0.006, 0, 0.035, 0.030),
    ]  # fmt: skip
    return [ellipses(neck, SKIN), ellipses(face, SKIN, sides=12), ellipses(hair, HAIR, sides=12)]


@cache
def thigh_mesh(length: float) -> Mesh:
    """A thigh that hangs down from the hip at the origin."""
    bone = limb([(0, 0, 0.02), (0, 0, -length)], (0.085, 0.060), TROUSERS, sides=10)
    return merged(bone, sphere((0, 0, -length), 0.060, TROUSERS, sides=8))


@cache
def shin_mesh(length: float) -> Mesh:
    """A shin with a shoe that hangs down from the knee at the origin."""
    bone = [(0, 0, 0), (-0.012, 0, -0.35 * length), (0, 0, -length)]
    shoe = [
        (-length - 0.08, 0.055, 0, 0.120, 0.040), (-length - 0.055, 0.055, 0, 0.125, 0.046),
        (-length - 0.02, 0.035, 0, 0.095, 0.044), (-length + 0.03, 0.0, 0, 0.055, 0.050),
    ]  # fmt: skip
    return merged(limb(bone, (0.060, 0.062, 0.046), TROUSERS, sides=10), ellipses(shoe, SHOES, sides=12))


class _Posture(NamedTuple):
    """Forward angles of a body that does not walk, radians; the torso's is negative."""

    torso: float
    thigh: float
    shin: float
    arm: float


POSTURES: Mapping[str, _Posture] = {
    "sitting": _Posture(-0.05, 1.45, 0.05, 0.5),
    "stooping": _Posture(-0.8, 0.1, -0.15, 0.3),
    "reaching": _Posture(-0.1, 0.05, -0.1, 1.1),
}


def pedestrian_parts(name: str, color: Rgb, trajectory: Carrier, posture: str = "upright") -> tuple[Part, ...]:
    """A pedestrian on a trajectory, with a jacket of this colour; `posture` is one of `Posture`."""
    looks, held = looks_of(name, color), POSTURES.get(posture)

    def body(states: F64) -> Poses:
        _, hip_z = _gait(states, held)
        return pitched(np.full(len(states), held.torso if held else 0.0), 0.0, 0.0, hip_z)

    parts = [Part(recolored(_torso(), looks), ArticulatedPath(trajectory, body))]
    thigh = recolored(thigh_mesh(THIGH_M), looks)
    shin = recolored(shin_mesh(SHIN_M), looks)
    for side in (1, -1):
        parts += [
            Part(thigh, ArticulatedPath(trajectory, _limb_place(side, "thigh", held))),
            Part(shin, ArticulatedPath(trajectory, _limb_place(side, "shin", held))),
            Part(recolored(_arm(side), looks), ArticulatedPath(trajectory, _limb_place(side, "arm", held))),
        ]
    return tuple(parts)


def _gait(states: F64, held: _Posture | None) -> tuple[dict[int, tuple[F64, F64]], F64]:
    """Forward angles (N) of thigh and shin by side, and the height (N) of the hips."""
    phase = 2 * np.pi * states[:, WALKED] / CYCLE_M
    effort = np.clip(np.abs(states[:, SPEED]) / FULL_STRIDE_M_S, 0.0, 1.0)
    legs, reaches = {}, []
    for side in (1, -1):
        turn = phase + (0.0 if side > 0 else np.pi)
        thigh = STRIDE_RAD * effort * np.sin(turn)
        # The knee bends most while the leg swings forward.
        shin = thigh - effort * (0.06 + KNEE_RAD * np.maximum(np.cos(turn - 0.1), 0.0) ** 1.5)
        if held:
            thigh, shin = np.full(len(states), held.thigh), np.full(len(states), held.shin)
        legs[side] = (thigh, shin)
        down = THIGH_M * np.cos(thigh) + SHIN_M * np.cos(shin)
        reaches += [down - (x * np.sin(shin) + z * np.cos(shin)) for x, z in (HEEL, TOE)]
    return legs, np.maximum.reduce(reaches)


def _limb_place(side: int, limb: Limb, held: _Posture | None) -> Callable[[F64], Poses]:
    def place(states: F64) -> Poses:
        legs, hip_z = _gait(states, held)
        thigh, shin = legs[side]
        if limb == "thigh":
            return pitched(thigh, 0.0, side * HIP_Y_M, hip_z)
        if limb == "shin":
            return pitched(shin, THIGH_M * np.sin(thigh), side * HIP_Y_M, hip_z - THIGH_M * np.cos(thigh))
        if held:
            ahead, up = -np.sin(held.torso) * SHOULDER_ABOVE_HIP_M, np.cos(held.torso) * SHOULDER_ABOVE_HIP_M
            return pitched(np.full(len(states), held.arm), ahead, side * SHOULDER_Y_M, hip_z + up)
        swing = -thigh * (ARM_RAD / STRIDE_RAD)
        return pitched(swing, 0.0, side * SHOULDER_Y_M, hip_z + SHOULDER_ABOVE_HIP_M)

    return place


@cache
def _torso() -> Mesh:
    """Torso and head, with the hips at the origin."""
    hips = [(-0.11, 0, 0, 0.08, 0.11), (-0.04, 0, 0, 0.105, 0.160), (0.05, 0, 0, 0.10, 0.15)]
    trunk = [
        (-0.06, 0, 0, 0.132, 0.192), (0.10, 0, 0, 0.128, 0.175), (0.24, 0.005, 0, 0.122, 0.168),
        (0.40, 0.005, 0, 0.125, 0.185), (0.50, -0.005, 0, 0.105, 0.195), (0.555, -0.01, 0, 0.07, 0.12),
        (0.58, -0.01, 0, 0.055, 0.065),
    ]  # fmt: skip
    return merged(ellipses(hips, TROUSERS), ellipses(trunk, JACKET, sides=14), *head(0.0, 0.715))


@cache
def _arm(side: int) -> Mesh:
    """A slightly bent arm that hangs down from the shoulder at the origin."""
    elbow, (x, y) = (-0.01, side * 0.030, -0.28), (0.075, side * 0.025)
    hand = [(-0.61, x + 0.025, y, 0.022, 0.012), (-0.56, x + 0.02, y, 0.042, 0.022), (-0.50, x, y, 0.028, 0.024)]
    return merged(
        sphere((0, 0, -0.01), 0.056, JACKET, sides=8),
        limb([(0, 0, 0), elbow, (x, y, -0.51)], (0.055, 0.044, 0.034), JACKET),
        sphere(elbow, 0.044, JACKET, sides=8),
        ellipses(hand, SKIN, sides=8),
    )
