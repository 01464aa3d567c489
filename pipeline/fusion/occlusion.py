"""Which objects stand behind others, as far as points tell: a coarse picture of how far a camera sees.

A camera sees nothing behind a point of the cloud. The points of all lidars are sorted into cells of the image, and each
cell keeps the range of its nearest point (a depth buffer: Catmull, A subdivision algorithm for computer display of
curved surfaces, 1974). An object is hidden as far as the cells that it fills have a point that is nearer than the
object's near side. Cells without a point say nothing.

The ground is left out: a cell at the foot of an object also holds the ground in front of it, which hides nothing.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import F32, F64
from pipeline.core.rig import CameraSensor

__all__ = ["DepthPicture", "sampled"]


MAX_POINTS = 8192
"""Points that are looked at in a frame, evenly chosen from all: what hides an object is large."""

CELLS = 32
"""Cells along the longer side of the image."""

NEARER_SHARE = 0.97
"""Points hide an object if they are nearer than this share of the range of its near side."""

OPEN_CELLS = 1.0
"""Cells that are taken to be free beside those that are measured, so that a single point hides nothing wholly."""


def sampled(xyz: F32) -> F32:
    """At most `MAX_POINTS` of the points (N, 3), evenly chosen."""
    return xyz[:: -(-len(xyz) // MAX_POINTS) or 1]


@dataclass(frozen=True, eq=False)
class DepthPicture:
    """How far a camera sees.

    Attributes:
        range_m: (rows, columns) float32, range of the nearest point from the camera in each cell; inf without one.
        cell_px: Width and height of a cell in pixels.
    """

    range_m: F32
    cell_px: float

    @classmethod
    def of(cls, view: CameraSensor, xyz_site: F32) -> "DepthPicture":
        """The picture of points (N, 3) in the site frame, metres."""
        model = view.model
        cell_px = max(model.width_px, model.height_px) / CELLS
        shape = -(-model.height_px // cell_px), -(-model.width_px // cell_px)
        rows, columns = int(shape[0]), int(shape[1])
        nearest = np.full(rows * columns, np.inf, np.float32)
        points = np.asarray(view.T_camera_site.apply(xyz_site))
        points = points[points[:, 2] > 0]
        pixels, is_valid = model.project(points)
        u, v = pixels.T
        is_valid &= (u >= 0) & (v >= 0) & (u < model.width_px) & (v < model.height_px)
        points, u, v = points[is_valid], u[is_valid], v[is_valid]
        cells = (v / cell_px).astype(np.intp) * columns + (u / cell_px).astype(np.intp)
        np.minimum.at(nearest, cells, np.sqrt((points * points).sum(1)))
        return cls(nearest.reshape(rows, columns), cell_px)

    def hidden(self, xyxy: F32, range_m: F64) -> F64:
        """(N,) share of each object that nearer points cover, in [0, 1).

        Args:
            xyxy: (N, 4) rectangles of the objects in the image, pixels; finite.
            range_m: (N,) range of the near side of each, metres.
        """
        first = np.floor(xyxy[:, :2] / self.cell_px)
        last = np.maximum(np.ceil(xyxy[:, 2:] / self.cell_px), first + 1)
        row, column = (np.arange(n, dtype=np.float64) for n in self.range_m.shape)
        down = (row >= first[:, 1:]) & (row < last[:, 1:])
        across = (column >= first[:, :1]) & (column < last[:, :1])
        inside = down[:, :, None] & across[:, None, :]
        measured = inside & np.isfinite(self.range_m)
        nearer = measured & (self.range_m < NEARER_SHARE * range_m[:, None, None])
        return np.asarray(nearer.sum((1, 2)) / (measured.sum((1, 2)) + OPEN_CELLS))
