"""Pillars: the cells of a grid over the ground, and the features that a network gets of the points above each cell.

After Lang et al., "PointPillars: Fast encoders for object detection from point clouds", CVPR 2019. Intensities are left
out: they differ between lidars, and the simulator's match no real lidar.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.settings.model import Count, Positive, SettingsModel
from lidcam.pipeline.native.kernels import pillar_features

FEATURES = ("height", "dx_mean", "dy_mean", "dheight_mean", "dx_cell", "dy_cell", "log_points", "distance")
"""Features of each point: its height above the ground, its offset from the mean of the points of its pillar and from
the middle of the pillar, the logarithm of their number, and its distance from the middle of the grid."""

STRIDE = 2
"""Pillars along x and y for each cell of the network's output."""

STEP_M = 2.0**-14
"""Coordinates are rounded to this step, so that their sums are exact and the same for any order of the points."""


class Grid(SettingsModel):
    """A square of pillars around the lidars."""

    cell_m: Positive  # Side of a pillar, metres
    cells: Count  # Pillars along x and along y, a multiple of 8
    low_m: float  # Points at a lower height above the ground are left out
    high_m: float  # Points at this height or higher are left out

    @property
    def half_m(self) -> float:
        """Half the side of the square."""
        return self.cell_m * self.cells / 2


def pillars(position: F64, grid: Grid) -> tuple[F32, I64]:
    """The features that a network gets of the points within the grid.

    Args:
        position: (N, 3) x and y from the middle of the grid, and height above the ground, metres.
        grid: The grid.

    Returns:
        (P, 8) float32 `FEATURES` in units of cells (height: metres; distance: half sides), and (P,) the pillar of each
        of these points: its row along y, times the number of columns, plus its column along x.
    """
    features, cell, count, xy = pillar_features(
        np.ascontiguousarray(position), grid.cell_m, grid.cells, grid.low_m, grid.high_m, STEP_M
    )
    logarithms = np.log(np.arange(1, count.max(initial=0) + 1))
    features[:, 6] = logarithms[count - 1]
    features[:, 7] = np.hypot(xy[:, 0], xy[:, 1]) / grid.half_m
    return features, cell
