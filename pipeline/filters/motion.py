"""Positions of points at one moment, if the sensor moves.

In motion compensation the scene is assumed static in the fixed frame; moving objects stay blurred by their own motion.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, I64
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples, interpolate_poses
from lidcam.pipeline.native.kernels import moved_each

STEP_NS = 1_000_000
"""Interval of interpolated poses, with points moved linearly between: exact to 13 um at 100 m and 1 rad/s."""


def deskew(xyz_moving: F32, point_stamps_ns: I64, stamp_ns: int, motion: PoseSamples) -> F32:
    """Points (N, 3) in the moving frame as it is at `stamp_ns`.

    Args:
        xyz_moving: (N, 3) metres, each in the moving frame as it was when the point was measured.
        point_stamps_ns: (N,) times of measurement.
        stamp_ns: Time to transform the points to.
        motion: At least two poses; extrapolated beyond the ends (see `PoseSamples.covers`).
    """
    if not len(xyz_moving):
        return xyz_moving
    start_ns = int(point_stamps_ns.min())
    since_ns = point_stamps_ns - start_ns
    knots_ns = start_ns + STEP_NS * np.arange(int(since_ns.max()) // STEP_NS + 2)
    poses = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, np.append(knots_ns, stamp_ns))
    # Relative motion in float64: poses may be kilometres from the origin of a map, the motion within a sweep is metres.
    T_target_knot = (np.linalg.inv(poses[-1]) @ poses[:-1])[:, :3].astype(np.float32)
    return moved_each(np.ascontiguousarray(xyz_moving), since_ns, T_target_knot, STEP_NS)
