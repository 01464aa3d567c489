"""The points of a cloud in convex regions: compiled, most points are left out many at a time."""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.core.geometry.boxes import rotations_2d

RUN = 16
"""Successive points tested together: neighbours in a scan are neighbours in space."""


def points_in_footprints(xyz: F32, centers_xy: F64, sizes_xy: F64, yaws: F64) -> tuple[I64, I64]:
    """Which points lie in which of B rectangles, seen from above; borders belong to them.

    Args:
        xyz: (N, 3) metres, of which x and y count.
        centers_xy: (B, 2) metres.
        sizes_xy: (B, 2) length and width, metres.
        yaws: (B,) of the length, about +z.

    Returns:
        As `points_in_regions`.
    """
    axes, half = rotations_2d(yaws).swapaxes(1, 2), sizes_xy / 2
    place = (axes * centers_xy[:, None]).sum(2)
    planes = np.zeros((len(yaws), 4, 4))
    planes[:, :2, :2], planes[:, :2, 3] = axes, half - place
    planes[:, 2:, :2], planes[:, 2:, 3] = -axes, half + place
    return points_in_regions(xyz, planes)


def points_in_regions(xyz: F32, planes: F64) -> tuple[I64, I64]:
    """Which points lie in which of R convex regions.

    Args:
        xyz: (N, 3) metres.
        planes: (R, K, 4) a, b, c, d of the planes around each region: within is where a x + b y + c z + d >= 0.

    Returns:
        (P,) rows of the points, sorted by region and then by row, and (P,) the region of each; a point that lies in
        several comes several times.
    """
    return _points_in_regions(np.ascontiguousarray(xyz), np.ascontiguousarray(planes))


@inlined
def _bounds(xyz: F32) -> F32:
    """(runs, 2, 3) least x, y, z and largest x, y, z of the points of each run."""
    bounds = np.empty(((len(xyz) + RUN - 1) // RUN, 2, 3), np.float32)
    for run in range(len(bounds)):
        for axis in range(3):
            low = high = xyz[run * RUN, axis]
            for i in range(run * RUN + 1, min(run * RUN + RUN, len(xyz))):
                low = xyz[i, axis] if xyz[i, axis] < low else low
                high = xyz[i, axis] if xyz[i, axis] > high else high
            bounds[run, 0, axis], bounds[run, 1, axis] = low, high
    return bounds


@compiled("Tuple((int64[::1], int64[::1]))(Array(float32, 2, 'C', readonly=True), float64[:, :, ::1])")
def _points_in_regions(xyz: F32, planes: F64) -> tuple[I64, I64]:
    rows, region = np.empty(1024, np.int64), np.empty(1024, np.int64)
    found, bounds = 0, _bounds(xyz)
    for r in range(len(planes)):
        for run in range(len(bounds)):
            is_outside = False
            for k in range(planes.shape[1]):
                # The corner of the run's bounds that is furthest inside; rounding is monotone.
                a, b, c, d = planes[r, k, 0], planes[r, k, 1], planes[r, k, 2], planes[r, k, 3]
                x, y, z = bounds[run, int(a > 0), 0], bounds[run, int(b > 0), 1], bounds[run, int(c > 0), 2]
                if not a * x + b * y + c * z + d >= 0:
                    is_outside = True
                    break
            if is_outside:
                continue
            for i in range(run * RUN, min(run * RUN + RUN, len(xyz))):
                is_within = True
                for k in range(planes.shape[1]):
                    a, b, c, d = planes[r, k, 0], planes[r, k, 1], planes[r, k, 2], planes[r, k, 3]
                    if not a * xyz[i, 0] + b * xyz[i, 1] + c * xyz[i, 2] + d >= 0:
                        is_within = False
                        break
                if is_within:
                    if found == len(rows):
                        rows = np.concatenate((rows, np.empty(found, np.int64)))
                        region = np.concatenate((region, np.empty(found, np.int64)))
                    rows[found], region[found] = i, r
                    found += 1
    return rows[:found].copy(), region[:found].copy()
