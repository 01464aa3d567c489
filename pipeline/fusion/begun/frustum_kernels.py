"""The loops of `frustums.py` over all points of a cloud."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled

__all__ = ["points_within", "seen_by_cameras"]

RUN = 16
"""So many points that follow each other are looked at together: neighbours in a scan are neighbours in space."""

ROWS = "Array(float64, 2, 'C', readonly=True)"


@compiled("float32[:, ::1](Array(float32, 2, 'C', readonly=True))")
def _bounds(xyz: F32) -> F32:
    """(R, 6) least x, y, z and largest x, y, z of the points of each run."""
    bounds = np.empty(((len(xyz) + RUN - 1) // RUN, 6), np.float32)
    for run in range(len(bounds)):
        first = run * RUN
        x, y, z = xyz[first, 0], xyz[first, 1], xyz[first, 2]
        top_x, top_y, top_z = x, y, z
        for i in range(first + 1, min(first + RUN, len(xyz))):
            own_x, own_y, own_z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
            x, top_x = own_x if own_x < x else x, own_x if own_x > top_x else top_x
            y, top_y = own_y if own_y < y else y, own_y if own_y > top_y else top_y
            z, top_z = own_z if own_z < z else z, own_z if own_z > top_z else top_z
        bounds[run, 0], bounds[run, 1], bounds[run, 2] = x, y, z
        bounds[run, 3], bounds[run, 4], bounds[run, 5] = top_x, top_y, top_z
    return bounds


@compiled("Tuple((int64, int64[::1], int64[::1]))(Array(float32, 2, 'C', readonly=True), float32[:, :, ::1])")
def points_within(xyz: F32, planes: F32) -> tuple[int, I64, I64]:
    """Which points are on the positive side of all planes of which frustums.

    Args:
        xyz: (N, 3) metres.
        planes: (F, K, 4) a, b, c, d around each frustum: a point is within where a x + b y + c z + d > 0.

    Returns:
        The number of pairs, and room for them: the rows of the points, rising in each frustum, and the frustums.
    """
    rows, frustum = np.empty(1024, np.int64), np.empty(1024, np.int64)
    found, bounds, through = 0, _bounds(xyz), np.empty(planes.shape[1], np.int64)
    for f in range(len(planes)):
        for run in range(len(bounds)):
            # The corner of the run's bounds that is furthest on the positive side, and the one furthest on the other:
            # rounding is monotone.
            is_outside, count = False, 0
            for k in range(planes.shape[1]):
                a, b, c, d = planes[f, k, 0], planes[f, k, 1], planes[f, k, 2], planes[f, k, 3]
                x, other_x = (bounds[run, 3], bounds[run, 0]) if a > 0 else (bounds[run, 0], bounds[run, 3])
                y, other_y = (bounds[run, 4], bounds[run, 1]) if b > 0 else (bounds[run, 1], bounds[run, 4])
                z, other_z = (bounds[run, 5], bounds[run, 2]) if c > 0 else (bounds[run, 2], bounds[run, 5])
                if not a * x + b * y + c * z + d > 0:
                    is_outside = True
                    break
                if not a * other_x + b * other_y + c * other_z + d > 0:
                    through[count] = k
                    count += 1
            if is_outside:
                continue
            for i in range(run * RUN, min(run * RUN + RUN, len(xyz))):
                is_within = True
                for j in range(count):
                    k = through[j]
                    a, b, c, d = planes[f, k, 0], planes[f, k, 1], planes[f, k, 2], planes[f, k, 3]
                    if not a * xyz[i, 0] + b * xyz[i, 1] + c * xyz[i, 2] + d > 0:
                        is_within = False
                        break
                if is_within:
                    if found == len(rows):
                        more_rows, more = np.empty(2 * found, np.int64), np.empty(2 * found, np.int64)
                        for j in range(found):
                            more_rows[j], more[j] = rows[j], frustum[j]
                        rows, frustum = more_rows, more
                    rows[found], frustum[found] = i, f
                    found += 1
    return found, rows, frustum


@compiled(
    f"float64[:, ::1](Array(float32, 2, 'C', readonly=True), int64[::1], int64[::1], "
    f"Array(float64, 3, 'C', readonly=True), {ROWS}, {ROWS}, {ROWS}, {ROWS}, {ROWS})"
)
def seen_by_cameras(
    xyz: F32, rows: I64, frustum: I64, rotations: F64, translations: F64, low: F64, high: F64, origin: F64, heading: F64
) -> F64:
    """(3, P) `share_x`, `share_y` and `along_m` of `FrustumPoints`.

    Args:
        xyz: (N, 3) metres in the site frame.
        rows: (P,) of the points.
        frustum: (P,) of each.
        rotations: (F, 3, 3) from the site to the optical frame of each frustum's camera.
        translations: (F, 3) metres.
        low: (F, 2) least x / z and y / z of the frustums.
        high: (F, 2) largest ones.
        origin: (F, 3) the cameras in the site frame.
        heading: (F, 2) unit vectors along the frustums, seen from above.
    """
    seen = np.empty((3, len(rows)))
    for i in range(len(rows)):
        f = frustum[i]
        x, y, z = np.float64(xyz[rows[i], 0]), np.float64(xyz[rows[i], 1]), np.float64(xyz[rows[i], 2])
        depth = x * rotations[f, 2, 0] + y * rotations[f, 2, 1] + z * rotations[f, 2, 2] + translations[f, 2]
        for axis in range(2):
            aside = x * rotations[f, axis, 0] + y * rotations[f, axis, 1] + z * rotations[f, axis, 2]
            place = (aside + translations[f, axis]) / depth
            seen[axis, i] = (place - low[f, axis]) / (high[f, axis] - low[f, axis])
        seen[2, i] = (x - origin[f, 0]) * heading[f, 0] + (y - origin[f, 1]) * heading[f, 1]
    return seen
