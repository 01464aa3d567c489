"""The direction of the lane beside what stands: most vehicles are parked the way that others drive past them."""

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.tracking.motion import HEADING, SPEED, Motions

DRIVES_PER_S = 0.5
"""What drives moves by more than this share of the length of what stands in a second; slower, it may be parking."""

NEAREST_SHARE = 0.4
"""Nothing drives nearer to the middle of what stands than this share of its length."""

PARALLEL_RAD = np.radians(20)


def driven_paths(motions: Motions, sites_xy: F64, stamps_s: F64) -> F64:
    """(M, 4) x, y, direction and speed of tracks and of the rig.

    Args:
        motions: Tracks at some moments.
        sites_xy: (F, 2) places of the rig.
        stamps_s: (F,) rising times of them.
    """
    states = motions.states
    backwards = np.pi * (states[:, SPEED] < 0)
    paths = np.column_stack([states[:, :2], states[:, HEADING] + backwards, np.abs(states[:, SPEED])])
    if len(stamps_s) < 2:
        return paths
    x_m_s, y_m_s = np.gradient(sites_xy, stamps_s, axis=0).T
    own = np.column_stack([sites_xy, np.arctan2(y_m_s, x_m_s), np.hypot(x_m_s, y_m_s)])
    return np.concatenate([paths, own])


def lane_directions(standing: F64, reach_m: F64, paths: F64) -> F64:
    """(T,) direction of the nearest path that runs past each, parallel to it; NaN where there is none.

    Args:
        standing: (T, 3) x, y and heading of what stands, the heading to within half a turn.
        reach_m: (T,) its length. So far from its middle the nearest lane may be; the one beyond may go the other way.
        paths: (M, 4) as of `driven_paths`.
    """
    out = np.full(len(standing), np.nan)
    for row, ((x, y, heading), within_m) in enumerate(zip(standing, reach_m, strict=True)):
        away_m = np.hypot(paths[:, 0] - x, paths[:, 1] - y)
        beside = (away_m > NEAREST_SHARE * within_m) & (away_m < within_m)
        beside &= np.abs(np.sin(paths[:, 2] - heading)) < np.sin(PARALLEL_RAD)
        beside &= paths[:, 3] > DRIVES_PER_S * within_m
        if beside.any():
            out[row] = paths[np.where(beside, away_m, np.inf).argmin(), 2]
    return out
