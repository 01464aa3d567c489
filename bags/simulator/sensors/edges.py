"""Which beams of a sweep may meet the edge of something: their neighbours see something else, nearer or further."""

from enum import IntEnum

import numpy as np

from bags.simulator.world.placed import dotted
from pipeline.core.arrays import F64, I64, Bools

__all__ = ["Side", "edge_beams"]


SKY_M = 1e5
"""Stands for the range of a beam that meets nothing."""


class Side(IntEnum):
    """Where the next beam is: that of the firing before or after, or of the laser below or above."""

    BEFORE = 0
    AFTER = 1
    BELOW = 2
    ABOVE = 3


def edge_beams(
    distance_m: F64,
    normal: F64,
    origins: F64,
    directions: F64,
    *,
    step_m: float,
    reach_m: float,
    by_elevation: I64,
) -> Bools:
    """On which sides of a beam what it meets ends, or what the next beam meets.

    The nearer of two surfaces ends between two beams if it would be before the other one's, were it to go on flat:
    neither a floor that is seen flat, nor the foot of a wall has edges.

    Args:
        distance_m: (F, L) by firing and laser; infinite for a miss.
        normal: (F, L, 3) of the surfaces, towards the beams.
        origins: (F, L, 3) of the beams, metres.
        directions: (F, L, 3) of the beams, unit vectors.
        step_m: Steps in range smaller than this do not matter.
        reach_m: Neither do those where both beams meet nothing before this.
        by_elevation: (L,) lasers from the lowest to the highest.

    Returns:
        (F, L, 4): by `Side`.
    """
    firings, lasers = distance_m.shape
    range_m = np.minimum(distance_m, SKY_M)
    flat_m, normals = range_m.reshape(-1), normal.reshape(-1, 3)
    starts, ahead = origins.reshape(-1, 3), directions.reshape(-1, 3)

    def ends(one: I64, other: I64) -> Bools:
        swapped = flat_m.take(one) > flat_m.take(other)
        near, far = np.where(swapped, other, one), np.where(swapped, one, other)
        face, near_m = normals.take(near, 0), flat_m.take(near)
        depth_m = dotted(face, starts.take(near, 0) - starts.take(far, 0))
        depth_m += near_m * dotted(face, ahead.take(near, 0))
        along = dotted(face, ahead.take(far, 0))
        # A plane that the other beam never meets is as good as one behind all.
        goes_on_m = depth_m / np.where(along < 0, along, -1e-12)
        return np.asarray((goes_on_m < flat_m.take(far) - step_m) & (near_m < reach_m))

    stacked = range_m[:, by_elevation]
    firing, place = np.nonzero(np.abs(stacked[:, 1:] - stacked[:, :-1]) > step_m)
    beside = np.flatnonzero(np.abs(range_m[1:] - range_m[:-1]) > step_m)
    pairs = (
        (beside, beside + lasers, Side.BEFORE, Side.AFTER),
        (firing * lasers + by_elevation[place], firing * lasers + by_elevation[place + 1], Side.BELOW, Side.ABOVE),
    )
    edges = np.zeros((firings * lasers, 4), np.bool_)
    for one, other, back, on in pairs:
        differ = ends(one, other)
        edges[one[differ], on] = edges[other[differ], back] = True
    return edges.reshape(firings, lasers, 4)
