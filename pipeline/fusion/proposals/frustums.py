"""The points that lie where 2D boxes look."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Rows, select_rows
from pipeline.core.compiled import compiled
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["FrustumPoints", "heading_of", "points_in_frustums"]

SHRINK_SHARE = 0.03
"""A frustum is narrower than its 2D box by this share at either side: edges of boxes stand off, and show what is
behind."""

RUN = 16
"""So many points that follow each other are looked at together: neighbours in a scan are neighbours in space."""


@dataclass(frozen=True, eq=False)
class FrustumPoints:
    """P points in frustums, frustum after frustum; a point may be in several.

    Attributes:
        rows: (P,) int64 row of each in the cloud, rising within a frustum.
        group: (P,) int64 the frustum.
        share_x: (P,) float64 where it is between the left side of the frustum, 0, and the right one, 1.
        share_y: (P,) float64 the same from top to bottom.
        along_m: (P,) float64 horizontal distance from the camera, in the direction of the frustum's middle.
    """

    rows: I64
    group: I64
    share_x: F64
    share_y: F64
    along_m: F64

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, rows: Rows) -> "FrustumPoints":
        """The given rows (mask or indices), in that order."""
        return select_rows(self, rows)


def points_in_frustums(xyz: F32, sightings: Sightings, nearest_m: F64, furthest_m: F64) -> FrustumPoints:
    """The points of a cloud in the frustum of each 2D box, between two distances.

    A frustum is bounded by planes: where a lens bends the sides of a box, by those around all of it.

    Args:
        xyz: (N, 3) metres in the site frame.
        sightings: F 2D boxes.
        nearest_m: (F,) least horizontal distance from the camera, along the middle of the box.
        furthest_m: (F,) largest one.
    """
    rays = sightings.rays @ sightings.views.rotations.swapaxes(1, 2)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SHRINK_SHARE * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    sides = _sides(sightings, low, high, nearest_m, furthest_m)
    count, rows, group = _points_within(np.ascontiguousarray(xyz), sides.astype(np.float32))
    rows, group = rows[:count], group[:count]
    points, views = xyz[rows].astype(np.float64), sightings.views
    ahead = (views.rotations[group] @ points[:, :, None])[..., 0] + views.translations[group]
    share_x, share_y = ((ahead[:, :2] / ahead[:, 2:] - low[group]) / (high - low)[group]).T
    along_m = ((points[:, :2] - sightings.origin[group, :2]) * heading_of(sightings)[group]).sum(1)
    return FrustumPoints(rows, group, share_x, share_y, along_m)


def heading_of(sightings: Sightings) -> F64:
    """(P, 2) unit vectors from the camera to the middle of each 2D box, seen from above."""
    middle = sightings.rays[:, 3] + sightings.rays[:, 7]
    return np.asarray(middle[:, :2] / np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)[:, None])


def _sides(sightings: Sightings, low: F64, high: F64, nearest_m: F64, furthest_m: F64) -> F64:
    """(F, 7, 4) planes a, b, c, d around each frustum: a point is within where a x + b y + c z + d > 0.

    Args:
        sightings: F 2D boxes.
        low: (F, 2) least x / z and y / z in the optical frame.
        high: (F, 2) largest ones.
        nearest_m: See `points_in_frustums`.
        furthest_m: See there.
    """
    right, down, ahead = np.concatenate(
        [sightings.views.rotations, sightings.views.translations[..., None]], 2
    ).transpose(1, 0, 2)
    level = np.zeros((len(sightings), 4))
    level[:, :2] = heading_of(sightings)
    level[:, 3] = -(level[:, :2] * sightings.origin[:, :2]).sum(1)
    end = np.array([0.0, 0.0, 0.0, 1.0])
    planes = [
        right - low[:, :1] * ahead,
        high[:, :1] * ahead - right,
        level - nearest_m[:, None] * end,
        furthest_m[:, None] * end - level,
        down - low[:, 1:] * ahead,
        high[:, 1:] * ahead - down,
        ahead,
    ]
    return np.stack(planes, 1)


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
def _points_within(xyz: F32, planes: F32) -> tuple[int, I64, I64]:
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
