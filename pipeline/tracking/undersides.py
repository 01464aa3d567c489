"""Heights of tracked objects: z of their undersides, by all measurements, each as sure as its points are many.

The z of a box is that of the ground below it, which is little seen far away. It changes slowly: for a static object by
no more than the error of the rig's motion.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, Bools
from lidcam.pipeline.tracking.smoothing import FRAME_CORRELATION, Courses

UNDERSIDE_SIGMA_M = 0.03
"""Standard deviation of the z of the underside of an object of many points, metres."""

UNDERSIDE_POINTS = 1000.0
"""Number of points of an object whose variance is twice that."""

SLOPE_SIGMA_M = 0.02
"""Standard deviation of the change of z over a metre that an object moves, metres; it grows as in a random walk."""

ROAD_SLOPE = 0.05
"""Standard deviation of the slope of the road that an object follows."""

DRIFT_SIGMA_M = 0.01
"""Standard deviation of the change of z over a metre that the rig moves, metres; it grows as in a random walk."""


def underside_variances(point_counts: I32) -> F64:
    """(N,) variances of the z of the undersides of objects, square metres."""
    return np.asarray(UNDERSIDE_SIGMA_M**2 * (1 + UNDERSIDE_POINTS / np.maximum(point_counts, 1)))


def climb_variances(objects_m: F64, rig_m: F64) -> F64:
    """(N,) variances of the change of z while objects (N,) and the rig (N,) move so far, metres."""
    return np.asarray(SLOPE_SIGMA_M**2 * objects_m + DRIFT_SIGMA_M**2 * rig_m)


def road_heights(courses: Courses, are_seen: Bools, z_m: F64, variances: F64, objects_m: F64) -> F64:
    """(N,) rise of all cells since the first of their track, on a road of even slope, by weighted least squares.

    The arguments are those of `smoothed_undersides` and `climb_variances`; a random walk alone lags on a slope.
    """
    tracks = courses.cell_tracks
    path_m = np.cumsum(objects_m)
    path_m -= path_m[courses.starts[:-1]][tracks]
    weights = are_seen / (FRAME_CORRELATION * variances)
    total = np.bincount(tracks, weights)
    along_m, rise_m = (values - (np.bincount(tracks, weights * values) / total)[tracks] for values in (path_m, z_m))
    information = np.bincount(tracks, weights * along_m**2) + 1 / ROAD_SLOPE**2
    return np.asarray((np.bincount(tracks, weights * along_m * rise_m) / information)[tracks] * path_m)


def smoothed_undersides(courses: Courses, are_seen: Bools, z_m: F64, variances: F64, climbs: F64) -> F64:
    """(N,) z of the undersides of all cells, as a random walk over all that is measured.

    Args:
        courses: T tracks; each is seen in its first frame.
        are_seen: (N,) whether a cell has a measurement.
        z_m: (N,) z of the measurements.
        variances: (N,) their variances.
        climbs: (N,) variance of the change since the frame before, as of `climb_variances`.
    """
    offsets = courses.starts[:-1] - courses.firsts  # the cell of a track in a frame is this, plus the frame
    frames = range(int(courses.firsts.min()), int(courses.lasts.max()) + 1) if len(courses) else range(0)
    gains = np.where(are_seen, 1.0, 0.0)
    filtered, spread = z_m.copy(), variances.copy()
    for frame in frames[1:]:
        at = offsets[(courses.firsts < frame) & (frame <= courses.lasts)] + frame
        before = spread[at - 1] + climbs[at]
        gains[at] *= before / (before + variances[at])
        filtered[at] = filtered[at - 1] + gains[at] * (z_m[at] - filtered[at - 1])
        spread[at] = (1 - gains[at]) * before
    for frame in reversed(frames[:-1]):
        at = offsets[(courses.firsts <= frame) & (frame < courses.lasts)] + frame
        filtered[at] += spread[at] / (spread[at] + climbs[at + 1]) * (filtered[at + 1] - filtered[at])
    return filtered
