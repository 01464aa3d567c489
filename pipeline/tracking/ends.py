"""The ends of objects: how far their points reach, for the length of their tracks."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.clouds import CombinedCloud
from pipeline.core.detections import Boxes3D, Fused

__all__ = ["find_ends"]

AROUND_SHARE = 0.62, 0.72, 0.6
"""Points within these shares of length, width and height of the centre of a box belong to it: also what it misses."""

BEYOND_SHARE = 0.2
"""So much of the width is added to that of the length."""

STRAY_SHARE = 0.005
"""Points beyond the end of an object, as a share of its points: stray ones."""

FEWEST_POINTS = 8


def find_ends(fused: Fused, combined: CombinedCloud) -> F64:
    """(N, 2, 3) the foremost and the rearmost point of each object, along the yaw of its box.

    Of each x, y in the site frame and seconds after the cloud's stamp; NaN where it has too few points.
    """
    objects, cloud = fused.objects, combined.detection_cloud
    ends = np.full((len(objects), 2, 3), np.nan)
    for row in range(len(objects)):
        ends[row] = _ends(objects, row, cloud.xyz, cloud.time_offset_ns)
    return ends


def _ends(objects: Boxes3D, row: int, xyz: np.ndarray, time_offset_ns: np.ndarray) -> F64:
    center, size, yaw = objects.centers[row], objects.sizes[row], objects.yaws[row]
    reach = np.hypot(*(AROUND_SHARE[axis] * size[axis] for axis in (0, 1))) + BEYOND_SHARE * size[1]
    low, high = (center[:2] - reach).astype(np.float32), (center[:2] + reach).astype(np.float32)
    x, y = xyz[:, 0], xyz[:, 1]
    near = np.flatnonzero((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]))
    away = xyz[near].astype(np.float64) - center
    along = away[:, 0] * np.cos(yaw) + away[:, 1] * np.sin(yaw)
    across = away[:, 1] * np.cos(yaw) - away[:, 0] * np.sin(yaw)
    inside = np.abs(along) < AROUND_SHARE[0] * size[0] + BEYOND_SHARE * size[1]
    inside &= (np.abs(across) < AROUND_SHARE[1] * size[1]) & (np.abs(away[:, 2]) < AROUND_SHARE[2] * size[2])
    points = near[inside]
    if len(points) < FEWEST_POINTS:
        return np.full((2, 3), np.nan)
    order = points[np.argsort(along[inside], kind="stable")]
    stray = int(STRAY_SHARE * len(order))
    ends = order[[len(order) - 1 - stray, stray]]
    return np.column_stack([xyz[ends, :2], time_offset_ns[ends] / 1e9]).astype(np.float64)
