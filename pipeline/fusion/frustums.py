"""The points that lie where 2D boxes look."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Rows, select_rows
from pipeline.fusion.sightings import Sightings

__all__ = ["FrustumPoints", "points_in_frustums"]

SHRINK_SHARE = 0.03
"""A frustum is narrower than its 2D box by this share at either side: edges of boxes stand off, and show what is
behind."""


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
    x, y, z = np.ascontiguousarray(xyz.T)
    rays = (sightings.views.rotations[:, None] * sightings.rays[:, :, None, :]).sum(3)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SHRINK_SHARE * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    right, down, ahead = sightings.views.rotations.transpose(1, 0, 2)
    shift = sightings.views.translations
    heading = heading_of(sightings)
    found = [_NOTHING]
    for row in range(len(sightings)):
        ox, oy, _ = sightings.origin[row]
        ex, ey = heading[row]
        rows = np.arange(len(x))
        sides = (
            (*(right[row] - low[row, 0] * ahead[row]), shift[row, 0] - low[row, 0] * shift[row, 2]),
            (*(high[row, 0] * ahead[row] - right[row]), high[row, 0] * shift[row, 2] - shift[row, 0]),
            (ex, ey, 0.0, -ex * ox - ey * oy - nearest_m[row]),
            (-ex, -ey, 0.0, ex * ox + ey * oy + furthest_m[row]),
            (*(down[row] - low[row, 1] * ahead[row]), shift[row, 1] - low[row, 1] * shift[row, 2]),
            (*(high[row, 1] * ahead[row] - down[row]), high[row, 1] * shift[row, 2] - shift[row, 1]),
            (*ahead[row], shift[row, 2]),
        )
        px, py, pz = x, y, z
        for a, b, c, d in np.array(sides, np.float32):
            inside = np.flatnonzero(a * px + b * py + c * pz + d > 0)
            rows, px, py, pz = rows[inside], px[inside], py[inside], pz[inside]
        points = np.stack([px, py, pz], 1).astype(np.float64)
        seen = (points[:, None] * sightings.views.rotations[row]).sum(2) + shift[row]
        share = (seen[:, :2] / seen[:, 2:] - low[row]) / (high[row] - low[row])
        along = (points[:, 0] - ox) * ex + (points[:, 1] - oy) * ey
        found.append(FrustumPoints(rows.astype(np.int64), np.full(len(rows), row), share[:, 0], share[:, 1], along))
    return FrustumPoints(*(np.concatenate([getattr(one, name) for one in found]) for name in _NAMES))


def heading_of(sightings: Sightings) -> F64:
    """(P, 2) unit vectors from the camera to the middle of each 2D box, seen from above."""
    middle = sightings.rays[:, 3] + sightings.rays[:, 7]
    return np.asarray(middle[:, :2] / np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)[:, None])


_NAMES = ("rows", "group", "share_x", "share_y", "along_m")
_NOTHING = FrustumPoints(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
