"""Motion of true objects over the ground, from differences of their places."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Indices, first_of_runs
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN

MAX_SPAN_NS = 1_500_000_000
"""Longest time from the frame before to the frame after: three labels in a row at 2 Hz, as in nuScenes."""


def ground_poses(centers: F64, yaws: F64, T_fixed_site: F64) -> F64:
    """(N, 3) x and y in metres and heading in radians over the ground, in the fixed frame.

    Args:
        centers: (N, 3) in the site frame.
        yaws: (N,) in the site frame.
        T_fixed_site: (N, 4, 4) where the site frame is, for each object; NaN where that is not known.
    """
    places = np.einsum("nij,nj->ni", T_fixed_site[:, :2, :3], centers) + T_fixed_site[:, :2, 3]
    return np.column_stack([places, yaws + _yaws(T_fixed_site)])


def ground_turns(vectors: F64, T_fixed_site: F64) -> F64:
    """(N, 2) vectors along x and y of the site frame, as `ground_poses` in the fixed frame."""
    yaws = _yaws(T_fixed_site)
    x, y = vectors.T
    return np.column_stack([x * np.cos(yaws) - y * np.sin(yaws), x * np.sin(yaws) + y * np.cos(yaws)])


def true_velocities(frames: I32, stamps_ns: I64, class_ids: I32, tracks: I64, poses: F64) -> F64:
    """Central differences of true poses.

    Args:
        frames: (T,) number of the frame of each object.
        stamps_ns: (F,) time of each frame.
        class_ids: (T,) class of each object.
        tracks: (T,) the same for the same object in all frames, or `UNKNOWN`.
        poses: (T, 3) of `ground_poses`.

    Returns:
        (T, 3) velocity along x and y of the fixed frame in m/s, and yaw rate in rad/s; NaN where the object has no
        track, or is not known in the frame before or after, or these are more than `MAX_SPAN_NS` apart.
    """
    found = np.full((len(frames), 3), np.nan)
    order = np.lexsort((frames, tracks, class_ids))
    before, at, after = order[:-2], order[1:-1], order[2:]
    is_known = tracks[at] != UNKNOWN
    for other, step in ((before, -1), (after, 1)):
        is_same = (tracks[other] == tracks[at]) & (class_ids[other] == class_ids[at])
        is_known &= is_same & (frames[other] - frames[at] == step)
    before, at, after = before[is_known], at[is_known], after[is_known]
    span_ns = stamps_ns[frames[after]] - stamps_ns[frames[before]]
    is_near = (span_ns > 0) & (span_ns <= MAX_SPAN_NS)
    before, at, after, seconds = before[is_near], at[is_near], after[is_near], span_ns[is_near, None] / 1e9
    moves = poses[after] - poses[before]
    moves[:, 2] = wrap_angle(moves[:, 2])
    found[at] = moves / seconds
    return found


def has_moved(class_ids: I32, tracks: I64, poses: F64, lengths_m: F64) -> Bools:
    """(T,) whether true objects ever move by more than their class's length (C,).

    Not without class, track or place; arguments as of `true_velocities`.
    """
    is_known = (tracks != UNKNOWN) & (class_ids != UNKNOWN) & np.isfinite(poses).all(1)
    rows = np.flatnonzero(is_known)
    order: Indices = rows[np.lexsort((tracks[rows], class_ids[rows]))]
    moves = np.zeros(len(tracks), np.bool_)
    if len(order):
        starts = first_of_runs(tracks[order]) | first_of_runs(class_ids[order])
        first = np.flatnonzero(starts)
        places = poses[order, :2]
        extents = np.maximum.reduceat(places, first) - np.minimum.reduceat(places, first)
        is_far = np.hypot(extents[:, 0], extents[:, 1]) > lengths_m[class_ids[order[first]]]
        moves[order] = is_far[np.cumsum(starts) - 1]
    return moves


def _yaws(poses: F64) -> F64:
    return np.asarray(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
