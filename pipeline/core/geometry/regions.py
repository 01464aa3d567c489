"""The points of a cloud in convex regions."""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.geometry.boxes import rotations_2d
from lidcam.pipeline.native import kernels


def points_in_footprints(xyz: F32, centers_xy: F64, sizes_xy: F64, yaws: F64) -> tuple[I64, I64]:
    """Which points (N, 3) lie in which of B rectangles, seen from above; borders belong to them.

    Rectangles have centres and lengths and widths (B, 2), metres, and yaws (B,) about +z. Returns as
    `points_in_regions`.
    """
    axes, half = rotations_2d(yaws).swapaxes(1, 2), sizes_xy / 2
    place = (axes * centers_xy[:, None]).sum(2)
    planes = np.zeros((len(yaws), 4, 4))
    planes[:, :2, :2], planes[:, :2, 3] = axes, half - place
    planes[:, 2:, :2], planes[:, 2:, 3] = -axes, half + place
    return points_in_regions(xyz, planes)


def points_in_regions(xyz: F32, planes: F64) -> tuple[I64, I64]:
    """Which points (N, 3) lie in which of R convex regions.

    `planes` (R, K, 4) are a, b, c, d of those around each region: within is where a x + b y + c z + d >= 0. Returns
    (P,) rows of the points, sorted by region and then by row, and (P,) the region of each; a point that lies in several
    comes several times.
    """
    return kernels.points_in_regions(np.ascontiguousarray(xyz), np.ascontiguousarray(planes))
