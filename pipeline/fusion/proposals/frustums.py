"""The points that lie where 2D boxes look."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Rows, select_rows
from pipeline.core.geometry.regions import points_in_regions
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["FrustumPoints", "heading_of", "points_in_frustums"]

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
    rays = sightings.rays @ sightings.views.rotations.swapaxes(1, 2)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SHRINK_SHARE * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    rows, group = points_in_regions(xyz, _sides(sightings, low, high, nearest_m, furthest_m))
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
    """(F, 7, 4) planes around each frustum, see `points_in_regions`.

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
