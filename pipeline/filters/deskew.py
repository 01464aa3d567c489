"""Motion compensation: points measured along a moving sensor's way, brought to where they are seen from at one moment.

The scene is taken to stand still in the fixed frame; what moves by itself keeps its own blur.
"""

import numpy as np

from pipeline.core.arrays import F32, I64
from pipeline.core.geometry.pose_samples import PoseSamples
from pipeline.core.geometry.poses import interpolate_poses

__all__ = ["deskew"]

KNOT_NS = 1_000_000
"""Poses are interpolated at this step, points linearly between: within 13 um at 100 m while turning at 1 rad/s."""


def deskew(
    xyz_moving: F32,
    point_stamps_ns: I64,
    stamp_ns: int,
    motion: PoseSamples,
) -> F32:
    """Points (N, 3) of the moving frame, each where the frame at `stamp_ns` sees the place it was measured at.

    Args:
        xyz_moving: (N, 3) metres, each in the moving frame as it was at the point's own time.
        point_stamps_ns: (N,) times of measurement.
        stamp_ns: The moment to bring them to.
        motion: At least two poses; beyond their ends the last motion goes on (see `PoseSamples.covers`).
    """
    if not len(xyz_moving):
        return xyz_moving
    start_ns = int(point_stamps_ns.min())
    since_ns = point_stamps_ns - start_ns
    knots_ns = start_ns + KNOT_NS * np.arange(int(since_ns.max()) // KNOT_NS + 2)
    poses = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, np.append(knots_ns, stamp_ns))
    # Relative motion in float64: poses in a map may be kilometres from its origin, the way within a sweep is metres.
    T_target_knot = (np.linalg.inv(poses[-1]) @ poses[:-1])[:, :3].astype(np.float32)
    knot, rest_ns = np.divmod(since_ns, KNOT_NS)
    share = (rest_ns / KNOT_NS).astype(np.float32)[:, None, None]
    T_target_point = T_target_knot[knot] + share * np.diff(T_target_knot, axis=0)[knot]
    moved: F32 = np.einsum("nij,nj->ni", T_target_point[:, :, :3], xyz_moving)
    return moved + T_target_point[:, :, 3]
