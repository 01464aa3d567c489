"""Pedestrians (torso, thighs, shins with feet, arms) and cyclists (bicycle, fork, crank, legs) in rigid parts; metres.

A pedestrian's legs swing with the distance walked; the leg that reaches further down sets the height of the hips, so
one foot is always on the ground. A cyclist's feet follow the pedals; hip and knee angles follow from the lengths of
thigh and shin (two-link inverse kinematics).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Literal, NamedTuple
from zlib import crc32

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
from lidcam.bags.simulator.world.mesh import (
    CHROME,
    DARK,
    HEADLAMP,
    METAL,
    RUBBER,
    TAIL_LAMP,
    Material,
    Mesh,
    Rgb,
    box,
    cylinder,
    ellipses,
    limb,
    merged,
    sphere,
    torus,
)
from lidcam.bags.simulator.world.motion import (
    SPEED,
    STEERING,
    WALKED,
    ArticulatedPath,
    Carrier,
    Part,
    Poses,
    hinged,
    pitched,
)
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

CRANK = (0.44, 0.29)  # x and z of the crank axle
CRANK_M, PEDAL_Y_M = 0.17, 0.13
SEAT_HIP = (0.235, 0.98)
RIDER_THIGH_M, RIDER_SHIN_M = 0.42, 0.46
CRANK_CYCLE_M = 4.2  # distance per turn of the crank
FORK_HINGE = (1.05, 0.0, 0.34)
RAKE_RAD = 0.31


def looks_of(name: str, color: Rgb) -> tuple[Material, Material, Material, Material]:
    """Skin, hair, jacket (of this colour) and trousers of a person, by the name."""
    number = crc32(name.encode())
    skin, hair = Material("skin", SKINS[number % 4], 0.45), Material("hair", HAIRS[number // 4 % 4], 0.20)
    jacket = Material("jacket", color, 0.25 + 0.35 * float(np.mean(color)))
    return skin, hair, jacket, Material("trousers", TROUSER_COLORS[number // 16 % 4], 0.30)


REFERENCE = looks_of("", (0.123, 0.456, 0.789))
SKIN, HAIR, JACKET, TROUSERS = REFERENCE
"""The looks of all bodies, which are made once, to be recolored."""


def recolored(mesh: Mesh, looks: Sequence[Material]) -> Mesh:
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


def cyclist_parts(name: str, color: Rgb, trajectory: Carrier) -> tuple[Part, ...]:
    """A cyclist on a trajectory, with a jacket of this colour."""
    looks = looks_of(name, color)
    parts = [
        Part(recolored(_frame_and_rider(), looks), trajectory),
        Part(_fork(), ArticulatedPath(trajectory, _fork_place)),
        Part(_crank(), ArticulatedPath(trajectory, _crank_place)),
    ]
    thigh = recolored(thigh_mesh(RIDER_THIGH_M), looks)
    shin = recolored(shin_mesh(RIDER_SHIN_M), looks)
    for side in (1, -1):
        parts += [
            Part(thigh, ArticulatedPath(trajectory, _pedalling_place(side, "thigh"))),
            Part(shin, ArticulatedPath(trajectory, _pedalling_place(side, "shin"))),
        ]
    return tuple(parts)


def bicycle() -> Mesh:
    """A bicycle without a rider, in the base frame of a cyclist."""
    return merged(_frame(), _fork().moved(FORK_HINGE), _crank().moved((CRANK[0], 0.0, CRANK[1])))


def _crank_angle(states: F64) -> F64:
    """Angle (N,) of the left crank from straight ahead, clockwise seen from the right."""
    return np.asarray(2 * np.pi * states[:, WALKED] / CRANK_CYCLE_M)


def _fork_place(states: F64) -> Poses:
    return hinged(states[:, STEERING], RAKE_RAD, np.array(FORK_HINGE))


def _crank_place(states: F64) -> Poses:
    return pitched(-_crank_angle(states), CRANK[0], 0.0, CRANK[1])


def _pedalling_place(side: int, bone: str) -> Callable[[F64], Poses]:
    def place(states: F64) -> Poses:
        turn = _crank_angle(states) + (0.0 if side > 0 else np.pi)
        # The ankle is above and behind the pedal.
        ankle_x = CRANK[0] + CRANK_M * np.cos(turn) - 0.09 - SEAT_HIP[0]
        ankle_z = CRANK[1] - CRANK_M * np.sin(turn) + 0.10 - SEAT_HIP[1]
        reach = np.minimum(np.hypot(ankle_x, ankle_z), RIDER_THIGH_M + RIDER_SHIN_M - 1e-6)
        aim = np.arctan2(ankle_x, -ankle_z)
        at_hip = np.arccos((RIDER_THIGH_M**2 + reach**2 - RIDER_SHIN_M**2) / (2 * RIDER_THIGH_M * reach))
        thigh = aim + at_hip
        knee_x, knee_z = RIDER_THIGH_M * np.sin(thigh), -RIDER_THIGH_M * np.cos(thigh)
        if bone == "thigh":
            return pitched(thigh, SEAT_HIP[0], side * HIP_Y_M, SEAT_HIP[1])
        shin = np.arctan2(ankle_x - knee_x, knee_z - ankle_z)
        return pitched(shin, SEAT_HIP[0] + knee_x, side * HIP_Y_M, SEAT_HIP[1] + knee_z)

    return place


def _bicycle_wheel() -> Mesh:
    """A wheel with its hub at the origin."""
    radius = SHAPES["cyclist"].wheel_radius_m
    ends = [(0.92 * radius * np.cos(a), 0, 0.92 * radius * np.sin(a)) for a in np.pi * np.arange(8) / 8]
    spokes = [cylinder((-x, 0, -z), (x, 0, z), 0.0025, CHROME, sides=4) for x, _, z in ends]
    return merged(
        torus((0, 0, 0), radius, 0.036, RUBBER),
        torus((0, 0, 0), radius - 0.034, 0.020, METAL, around=4),
        cylinder((0, -0.05, 0), (0, 0.05, 0), 0.022, METAL, sides=8),
        *spokes,
    )


@cache
def _frame() -> Mesh:
    """The bicycle without fork and crank."""
    radius = SHAPES["cyclist"].wheel_radius_m
    lacquer = Material("bicycle frame", (0.12, 0.28, 0.42), 0.3, mirror=0.06)
    bottom, seat, head_low, head_high = (0.44, 0, 0.29), (0.265, 0, 0.78), (0.925, 0, 0.66), (0.885, 0, 0.80)
    tubes = [(bottom, seat, 0.017), (bottom, head_low, 0.020), ((0.285, 0, 0.73), head_high, 0.016)]
    stays = [((0, y, radius), end, 0.009) for y in (-0.055, 0.055) for end in (bottom, (0.285, 0.3 * y, 0.73))]
    return merged(
        *(cylinder(a, b, r, lacquer, sides=8) for a, b, r in (*tubes, *stays)),
        cylinder(head_low, head_high, 0.022, lacquer, sides=8),
        cylinder(seat, (0.245, 0, 0.86), 0.013, METAL, sides=8),
        box((0.235, 0, 0.885), (0.26, 0.15, 0.045), DARK),
        _bicycle_wheel().moved((0, 0, radius)),
        box((0.02, 0, 0.72), (0.36, 0.12, 0.012), METAL),
        box((-0.165, 0, 0.70), (0.02, 0.07, 0.05), TAIL_LAMP),
        *(cylinder((0.0, y, radius), (-0.05, y, 0.72), 0.006, METAL, sides=6) for y in (-0.058, 0.058)),
    )


@cache
def _fork() -> Mesh:
    """Front wheel, fork and handlebar, with the hub at the origin."""
    crown = (-0.115, 0, 0.36)
    stem = (-0.185, 0, 0.60)
    grip = [(-0.185, 0, 0.66), (-0.17, 0.13, 0.69), (-0.27, 0.255, 0.69), (-0.35, 0.273, 0.68)]
    radii = (0.013, 0.013, 0.016, 0.016)
    return merged(
        _bicycle_wheel(),
        *(cylinder((0, y, 0), (crown[0], y, crown[2]), 0.012, METAL, sides=8) for y in (-0.055, 0.055)),
        box(crown, (0.04, 0.14, 0.03), METAL),
        cylinder(crown, stem, 0.016, METAL, sides=8),
        cylinder(stem, grip[0], 0.013, METAL, sides=8),
        *(limb([(x, side * y, z) for x, y, z in grip], radii, DARK) for side in (1, -1)),
        box((-0.145, 0, 0.52), (0.06, 0.06, 0.06), HEADLAMP),
    )


@cache
def _crank() -> Mesh:
    """Cranks and pedals with their axle at the origin; the left crank points forward."""
    parts = [cylinder((0, -0.03, 0), (0, -0.045, 0), 0.09, METAL, sides=16)]
    for side in (1, -1):
        parts += [
            cylinder((0, side * 0.05, 0), (side * CRANK_M, side * 0.07, 0), 0.012, METAL, sides=6),
            box((side * CRANK_M, side * PEDAL_Y_M, 0), (0.07, 0.10, 0.02), DARK),
        ]
    return merged(*parts, cylinder((0, -0.07, 0), (0, 0.07, 0), 0.014, METAL, sides=8))


@cache
def _frame_and_rider() -> Mesh:
    """Frame, torso, head with a helmet, and arms that reach the grips."""
    x, z = 0.56, 1.585  # of the head
    hips = [(0.90, 0.235, 0, 0.12, 0.13), (0.96, 0.235, 0, 0.135, 0.17), (1.02, 0.25, 0, 0.11, 0.15)]
    trunk = [
        (0.955, 0.24, 0, 0.148, 0.185), (1.12, 0.30, 0, 0.135, 0.172), (1.26, 0.38, 0, 0.125, 0.175),
        (1.37, 0.445, 0, 0.12, 0.190), (1.425, 0.475, 0, 0.08, 0.13), (1.455, 0.495, 0, 0.055, 0.06),
    ]  # fmt: skip
    helmet = [
        (z + 0.015, x - 0.01, 0, 0.118, 0.088), (z + 0.06, x - 0.01, 0, 0.122, 0.090),
        (z + 0.11, x - 0.01, 0, 0.095, 0.070), (z + 0.135, x - 0.01, 0, 0.045, 0.035),
    ]  # fmt: skip
    parts = []
    for side in (1, -1):
        arm = [(0.475, side * 0.18, 1.37), (0.615, side * 0.242, 1.16), (0.72, side * 0.262, 1.035)]
        parts += [
            limb(arm, (0.056, 0.044, 0.032), JACKET),
            sphere((0.475, side * 0.18, 1.365), 0.056, JACKET, sides=8),
            sphere((0.615, side * 0.242, 1.16), 0.044, JACKET, sides=8),
            sphere((0.735, side * 0.258, 1.03), 0.040, SKIN, sides=8),
        ]
    return merged(
        _frame(),
        ellipses(hips, TROUSERS),
        ellipses(trunk, JACKET, sides=14),
        *parts,
        *head(x, z)[:2],  # no hair
        ellipses(helmet, Material("helmet", (0.85, 0.85, 0.82), 0.6, mirror=0.03), sides=14),
    )
