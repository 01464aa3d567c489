"""The points of an object that may be outermost in an image.

A cuboid around an object appears larger than the object: vehicles and people have round corners, and do not touch the
ground at the corners of their box. Seen across a corner, the rectangle around a projected cuboid is wider than the one
around the object by a fifth of the radius of the corner and more, on both sides. So the cuboid's corners are rounded.
"""

from functools import cache

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.fusion.projection import Outline

__all__ = ["rounded_outline"]

_INWARD = np.array([[0.0, 1.0], [1.0, 0.0]])
"""Where the straight line that stands for a round corner begins and ends, in units of what it cuts off both sides."""

CUT_PER_RADIUS = np.sqrt(2) * (np.sqrt(2) - 1)
"""A corner cut off by so much appears as far inside, seen across it, as one rounded by a radius of 1."""
_LEVELS = (-1.0, 0.2, 1.0)
"""Underside, belt line of a car, roof."""

AS_HIGH_AS_WIDE = 1.2
"""Height by width from which on an object is no car."""

UPRIGHT = 2.0
"""Height by width from which on an object is a person."""

TALL_ROUNDING = 0.4
"""Vans, trucks and buses have sharper corners than cars: their rounding is this share of it."""

RIDES = 2.0
"""Length by width from which on a person rides."""

_WHEEL_END, _WHEEL_GROUND, _HANDS, _HEAD = (1.0, 0.1, -0.6), (0.6, 0.1, -1.0), (0.2, 1.0, 0.25), (0.15, 0.3, 1.0)
"""Of a rider along, across and up, in halves of the box: the end of a wheel at the height of its axle and where it
stands, hands and shoulders, and the head."""

_SIDES = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])


def rounded_outline(sizes: F64, *, rounding: float, underside: float, cabin: float, bent: bool) -> Outline:
    """Boxes with round corners, seen from above, and a roof that is smaller than the body.

    Args:
        sizes: (P, 3) length, width, height, metres.
        rounding: Radius of the corners of a car, as a share of the smaller of length and width, at most 0.5. That of
            higher vehicles is less, by `TALL_ROUNDING`. Unless it is 0, objects that are higher than wide by `UPRIGHT`
            are people: round on foot, and with thin wheels in front and behind where they ride.
        underside: How far above the ground an object begins at its outline, as a share of its height.
        cabin: How much shorter and narrower the roof of a car is than its body, as a share. Cars are objects that are
            lower than wide; from `AS_HIGH_AS_WIDE` on there is no such roof.
        bent: Whether a lens bends lines.
    """
    signs, inward, of_riders = _round_points(bent=bent)
    smaller, height = sizes[:, :2].min(1), sizes[:, 2]
    is_upright = height > UPRIGHT * smaller
    low = ((AS_HIGH_AS_WIDE - height / sizes[:, 1]) / (AS_HIGH_AS_WIDE - 1)).clip(0.0, 1.0)
    round_share = 0.5 if rounding > 0 else 0.0
    share = np.where(is_upright, round_share, rounding * (TALL_ROUNDING + (1 - TALL_ROUNDING) * low))
    offsets = np.zeros((len(sizes), len(signs), 3))
    offsets[..., :2] = inward * (CUT_PER_RADIUS * share * smaller)[:, None, None]
    roof = signs[:, 2] == 1
    offsets[:, roof, :2] -= signs[roof, :2] * (cabin * low[:, None] * sizes[:, :2] / 2)[:, None]
    offsets[:, signs[:, 2] < 0, 2] = (underside * height)[:, None]
    rides = is_upright & (sizes[:, 0] > RIDES * sizes[:, 1]) & (rounding > 0)
    offsets[rides] = of_riders * sizes[rides, None] / 2
    return Outline(signs, offsets)


@cache
def _round_points(*, bent: bool) -> tuple[F64, F64, F64]:
    """Points of boxes with round corners.

    Returns:
        (S, 3) signs; (S, 2) which way each point is moved where a corner is cut off by 1; (S, 3) offsets, in halves of
        the box, of people on bicycles: thin wheels at the ends, a rider in the middle, a head on top.
    """
    corners = np.repeat(UNIT_CORNERS[:4, :2], len(_INWARD), axis=0)
    inward = np.tile(_INWARD, (4, 1))
    around = np.concatenate([corners, _SIDES]) if bent else corners
    inward = np.concatenate([inward, np.zeros_like(_SIDES)]) if bent else inward
    signs = np.concatenate([np.column_stack([around, np.full(len(around), level)]) for level in _LEVELS])
    inward = np.tile(inward, (len(_LEVELS), 1))
    place = np.where(inward[:, 1:] > 0, _WHEEL_END, _HANDS)
    place = np.where(signs[:, 2:] < 0, _WHEEL_GROUND, np.where(signs[:, 2:] == 1, _HEAD, place))
    place[:, :2] *= signs[:, :2]
    return signs, -np.sign(signs[:, :2]) * inward, place - signs
