"""A pedalling cyclist in rigid parts: bicycle and rider, fork, crank, thighs, shins with feet.

The feet follow the pedals; hip and knee angles follow from the lengths of thigh and shin (two-link inverse kinematics).
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from lidcam.bags.simulator.world.bodies.dimensions import SHAPES
from lidcam.bags.simulator.world.bodies.pedestrian import (
    HIP_Y_M,
    JACKET,
    SKIN,
    TROUSERS,
    head,
    looks_of,
    recolored,
    shin_mesh,
    thigh_mesh,
)
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
from lidcam.bags.simulator.world.motion import WALKED, ArticulatedPath, Carrier, Part, Poses, pitched, steered_fork
from lidcam.pipeline.core.arrays import F64

CRANK = (0.44, 0.29)  # x and z of the crank axle
CRANK_M, PEDAL_Y_M = 0.17, 0.13
SEAT_HIP = (0.235, 0.98)
RIDER_THIGH_M, RIDER_SHIN_M = 0.42, 0.46
CRANK_CYCLE_M = 4.2  # distance per turn of the crank
FORK_HINGE = (1.05, 0.0, 0.34)
RAKE_RAD = 0.31


def cyclist_parts(name: str, color: Rgb, trajectory: Carrier) -> tuple[Part, ...]:
    """A cyclist on a trajectory, with a jacket of this colour."""
    looks = looks_of(name, color)
    parts = [
        Part(recolored(_frame_and_rider(), looks), trajectory),
        Part(_fork(), steered_fork(trajectory, FORK_HINGE, RAKE_RAD)),
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
