"""Positions of points: within range, in the site frame, and, if the sensor moves, at one moment.

In motion compensation the scene is assumed static in the fixed frame; moving objects stay blurred by their own motion.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, I64, Bools
from lidcam.pipeline.core.compiled import compiled
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.poses import interpolate_poses

STEP_NS = 1_000_000
"""Interval of interpolated poses, with points moved linearly between: exact to 13 um at 100 m and 1 rad/s."""

POINTS = "Array(float32, 2, 'C', True)"
"""Type of points (N, 3), perhaps read-only."""


@compiled(f"boolean[::1]({POINTS}, float64, float64)")
def in_range(xyz: F32, min_m: float, max_m: float) -> Bools:
    """(N,) whether points (N, 3) are within these distances from the origin, both inclusive, and not at it."""
    kept = np.empty(len(xyz), np.bool_)
    low_m, high_m = np.float32(min_m), np.float32(max_m)
    for i in range(len(xyz)):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        range_m = np.sqrt(x * x + y * y + z * z)
        kept[i] = range_m > 0 and low_m <= range_m <= high_m
    return kept


@compiled(f"float32[:, ::1]({POINTS}, float32[:, ::1])")
def moved(xyz: F32, matrix: F32) -> F32:
    """Points (N, 3) moved by a matrix (3, 4)."""
    out = np.empty((len(xyz), 3), np.float32)
    for i in range(len(xyz)):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        for axis in range(3):
            row = matrix[axis]
            out[i, axis] = row[0] * x + row[1] * y + row[2] * z + row[3]
    return out


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
    return _moved_each(np.ascontiguousarray(xyz_moving), since_ns, T_target_knot)


@compiled(f"float32[:, ::1]({POINTS}, int64[::1], float32[:, :, ::1])")
def _moved_each(xyz: F32, since_ns: I64, matrices: F32) -> F32:
    """Points (N, 3), each moved by the matrix of its time."""
    out = np.empty((len(xyz), 3), np.float32)
    for i in range(len(xyz)):
        knot = np.int64(np.uint64(since_ns[i]) // np.uint64(STEP_NS))  # a division that need not look at the sign
        share = np.float32((since_ns[i] - knot * STEP_NS) / STEP_NS)
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        for axis in range(3):
            first, second = matrices[np.uint64(knot), axis], matrices[np.uint64(knot + 1), axis]
            a, b = first[0] + share * (second[0] - first[0]), first[1] + share * (second[1] - first[1])
            c, shift = first[2] + share * (second[2] - first[2]), first[3] + share * (second[3] - first[3])
            out[i, axis] = a * x + b * y + c * z + shift
    return out


def coordinates(xyz: F32, kept: Bools) -> F32:
    """(3, K) the coordinates of those points (N, 3) that are kept (N,)."""
    return np.ascontiguousarray(xyz.T).compress(kept, axis=1)
