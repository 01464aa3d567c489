"""The points that lie where 2D boxes look."""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Rows, select_rows
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["FrustumPoints", "points_in_frustums"]

SHRINK_SHARE = 0.03
"""A frustum is narrower than its 2D box by this share at either side: edges of boxes stand off, and show what is
behind."""


CELLS = 256
"""Cells along either side of the grid by which points are found: two numbers of it fit into 16 bits."""

REACH = 0.51
"""Points lie within this share of a cell's edge from its middle; the rest is rounding."""


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
    columns = _Columns(xyz)
    rays = (sightings.views.rotations[:, None] * sightings.rays[:, :, None, :]).sum(3)  # in the optical frames, depth 1
    low, high = rays[..., :2].min(1), rays[..., :2].max(1)
    margin = SHRINK_SHARE * (high - low) * [1, 0]
    low, high = low + margin, high - margin
    sides = _sides(sightings, low, high, nearest_m, furthest_m)
    rows = [columns.inside(planes) for planes in sides.astype(np.float32)]
    group = np.repeat(np.arange(len(rows)), [len(some) for some in rows])
    found = np.concatenate([np.zeros(0, np.int64), *rows])
    points = xyz[found].astype(np.float64)
    seen = (points[:, None] * sightings.views.rotations[group]).sum(2) + sightings.views.translations[group]
    share = (seen[:, :2] / seen[:, 2:] - low[group]) / (high - low)[group]
    along = ((points - sightings.origin[group])[:, :2] * heading_of(sightings)[group]).sum(1)
    return FrustumPoints(found, group.astype(np.int64), share[:, 0], share[:, 1], along)


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


class _Columns:
    """Points by the cells of a square grid seen from above, so that most need not be looked at."""

    def __init__(self, xyz: F32) -> None:
        x, y, z = np.ascontiguousarray(xyz.T)
        if not len(x):
            self._members = np.zeros(0, np.int64)
            return
        origin = x.min(), y.min()
        self._edge_m = max(float(x.max() - origin[0]), float(y.max() - origin[1]), 1e-3) / (CELLS - 1)
        scale = np.float32(1 / self._edge_m)
        column, line = (((value - low) * scale).astype(np.uint16) for value, low in zip((x, y), origin, strict=True))
        key = column * np.uint16(CELLS) + line
        self._members = np.argsort(key, kind="stable")
        key = key[self._members]
        self._starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        self._counts = np.diff(self._starts, append=len(key))
        key = key[self._starts].astype(np.int64)
        self._x = (origin[0] + (key // CELLS + 0.5) * self._edge_m).astype(np.float32)
        self._y = (origin[1] + (key % CELLS + 0.5) * self._edge_m).astype(np.float32)
        self._xyz = x[self._members], y[self._members], z[self._members]
        self._bottom = np.minimum.reduceat(self._xyz[2], self._starts)
        self._top = np.maximum.reduceat(self._xyz[2], self._starts)

    def inside(self, planes: F32) -> I64:
        """Rows of the points on the positive side of all planes (K, 4), rising."""
        if not len(self._members):
            return self._members
        a, b, c, d = planes.T[..., None]
        reach = (np.abs(a) + np.abs(b)) * np.float32(REACH * self._edge_m) + d
        height = np.where(c > 0, self._top, self._bottom)  # where the cell reaches furthest to the positive side
        cells = np.flatnonzero((a * self._x + b * self._y + c * height + reach > 0).all(0))
        counts = self._counts[cells]
        rows = np.arange(counts.sum()) + np.repeat(self._starts[cells] - np.cumsum(counts) + counts, counts)
        x, y, z = (column[rows] for column in self._xyz)
        rows = rows[(a * x + b * y + c * z + d > 0).all(0)]
        return np.sort(self._members[rows])
