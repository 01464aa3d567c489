"""Beams of a sweep that may hit an edge: those next to a jump in range."""

from enum import IntEnum

import numpy as np

from lidcam.bags.simulator.world.placed import dotted
from lidcam.pipeline.core.arrays import F64, I64, Bools

SKY_M = 1e5
"""Range of a beam that hits nothing."""


class Side(IntEnum):
    """The neighbour of a beam: in the firing before or after, or the laser below or above."""

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
    """The sides on which a beam has an edge, of its own surface or of its neighbour's.

    The nearer of two surfaces ends between two beams if its plane would still be in front at the other beam: a floor
    seen at a grazing angle or the foot of a wall is no edge.

    Args:
        distance_m: (F, L) by firing and laser; infinite for a miss.
        normal: (F, L, 3) normals of the surfaces, towards the beams.
        origins: (F, L, 3) origins of the beams, metres.
        directions: (F, L, 3) unit vectors.
        step_m: Smaller jumps in range are ignored.
        reach_m: Jumps beyond this range are ignored.
        by_elevation: (L,) lasers from the lowest to the highest.

    Returns:
        (F, L, 4) bool by `Side`.
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
        # A plane that the other beam never hits counts as infinitely far.
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
