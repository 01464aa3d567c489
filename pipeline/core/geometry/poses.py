"""Interpolation of poses."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.geometry.rotations import pose_matrix, rotation_vectors, turned


def interpolate_poses(stamps_ns: I64, poses: F64, wanted_ns: I64) -> F64:
    """(W, 4, 4) poses at wanted times (W,): positions linear, rotations by slerp, extrapolated at constant velocity.

    Known are poses (S, 4, 4) at strictly increasing stamps (S,), S >= 2.
    """
    # Times relative to the first stamp: float64 seconds of the Unix epoch would only resolve 240 ns.
    start = int(stamps_ns[0])
    known = (stamps_ns - start).astype(np.float64)
    wanted = (wanted_ns - start).astype(np.float64)
    row = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 2)
    share = (wanted - known[row]) / (known[row + 1] - known[row])
    rotations = poses[:, :3, :3]
    used, which = np.unique(row, return_inverse=True)
    steps = rotation_vectors(rotations[used].swapaxes(1, 2) @ rotations[used + 1])[which]
    places = poses[row, :3, 3] * (1 - share[:, None]) + poses[row + 1, :3, 3] * share[:, None]
    return pose_matrix(rotations[row] @ turned(steps * share[:, None]), places)
