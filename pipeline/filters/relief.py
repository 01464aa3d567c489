"""How the ground differs from its plane: slopes, crests, kerbs.

A surface grows from the plane outwards: the lowest points of small cells that lie near the surface pull it towards
them, smoothly, and so bring further points near. Walls and vehicles are not near, or not lowest. This is a filter of
the kind of Kraus and Pfeifer (Determination of terrain models in wooded areas with airborne laser scanner data, ISPRS
Journal 53(4), 1998), which weighs points by their height above the last surface, on a grid in place of linear
prediction.
"""

import numpy as np

from pipeline.core.arrays import F32, F64
from pipeline.core.clouds import Plane, Relief
from pipeline.core.settings.combine import GroundConfig

__all__ = ["find_relief"]


CELL_PER_DISTANCE = 10.0
"""Edge of a cell of the surface, as a multiple of `distance_m`."""

FINE_SHARE = 0.5
"""Edge of the cells whose lowest points are taken, as a share of that."""

LAYER_SHARE = 0.35
"""The height of a fine cell is the mean of its points up to this share of `distance_m` above the lowest."""

REACH_CELLS = 48
"""The surface reaches this many cells from the middle of the lidars to each side; beyond, it goes on level."""

MAX_SLOPE = 0.08
"""Points farther from the plane than this multiple of their distance from the lidars are no ground."""

ROUNDS = ((4.0, 3.0),) * 5 + ((2.0, 2.0),) * 2 + ((1.0, 1.0),) * 3
"""Rounds of growth: standard deviation of the smoothing in cells, and what is near, as a multiple of `distance_m`. The
wide ones bridge the gaps between the rings of a lidar and follow a slope; the narrow ones leave out what stands on it.
"""

ABOVE_PER_DISTANCE, ABOVE_WEIGHT = 0.75, 0.1
"""Weight of points that are higher above the last surface than this multiple of `distance_m`: they may stand on it."""

MOST_POINTS = 4.0
"""Fine cells of a cell that count: no cell pulls more than one full of ground."""

PRIOR_WEIGHT, FILL_CELLS, FILL_WEIGHT = 0.05, 5.0, 0.02
"""Weight of the last surface against the points of a cell; reach and weight of what is known where nothing is."""


def find_relief(xyz_site: F32, lidar_origins_site: F64, plane: Plane, config: GroundConfig) -> Relief:
    """The height of the ground above its plane.

    Args:
        xyz_site: (N, 3) points in the site frame, metres, finite.
        lidar_origins_site: (L, 3) origins of the lidars in the site frame, metres.
        plane: The ground plane of the same points.
        config: What belongs to the ground.
    """
    cell_m = CELL_PER_DISTANCE * config.distance_m
    middle = lidar_origins_site[:, :2].mean(axis=0)
    origin = middle - REACH_CELLS * cell_m
    side = 2 * REACH_CELLS + 1
    xy, height = _lowest(xyz_site, lidar_origins_site, plane, origin, cell_m, config.distance_m)
    column, row = np.rint((xy - origin).T / cell_m).astype(np.int64)
    flat = row * side + column
    surface, weight = Relief(origin, cell_m, np.zeros((side, side))), np.zeros((side, side))
    for spread_cells, reach in ROUNDS:
        above, near_m = height - surface.offset_m(xy), reach * config.distance_m
        pull = np.where(above > ABOVE_PER_DISTANCE * config.distance_m, ABOVE_WEIGHT, 1.0) * (np.abs(above) <= near_m)
        total = np.bincount(flat, pull, side * side)
        mean = np.bincount(flat, pull * above, side * side) / np.maximum(total, 1e-9)
        weight = np.minimum(total, MOST_POINTS).reshape(side, side)
        pulled = _smooth(weight * mean.reshape(side, side), spread_cells)
        surface = Relief(origin, cell_m, surface.offsets_m + pulled / (_smooth(weight, spread_cells) + PRIOR_WEIGHT))
    known = weight / MOST_POINTS
    filled = _smooth(known * surface.offsets_m, FILL_CELLS) / (_smooth(known, FILL_CELLS) + FILL_WEIGHT)
    trust = _smooth(known, 1.0)
    trust = trust / (trust + FILL_WEIGHT)
    return Relief(origin, cell_m, trust * surface.offsets_m + (1 - trust) * filled)


def _lowest(
    xyz: F32, lidar_origins_site: F64, plane: Plane, origin: F64, cell_m: float, distance_m: float
) -> tuple[F64, F64]:
    """The middles of the fine cells that hold ground, perhaps (M, 2), and their lowest heights above the plane (M,)."""
    fine_m = FINE_SHARE * cell_m
    side = round(2 * REACH_CELLS / FINE_SHARE)
    x, y, z = np.ascontiguousarray(xyz.T)  # a row per coordinate: several times faster than rows of three
    a, b, c = plane.normal.astype(np.float32)
    height = (x * a + y * b + z * c + np.float32(plane.offset_m)) / c
    middle = lidar_origins_site[:, :2].mean(axis=0).astype(np.float32)
    reach_m = np.float32(distance_m) + np.float32(MAX_SLOPE) * np.hypot(x - middle[0], y - middle[1])
    column = np.floor((x - np.float32(origin[0])) / np.float32(fine_m))
    row = np.floor((y - np.float32(origin[1])) / np.float32(fine_m))
    kept = (np.abs(height) <= reach_m) & (column >= 0) & (column < side) & (row >= 0) & (row < side)
    lowest = np.full(side * side, np.inf, np.float32)
    cell, height = (row[kept] * side + column[kept]).astype(np.int64), height[kept]
    np.minimum.at(lowest, cell, height)
    low = height <= lowest[cell] + np.float32(LAYER_SHARE * distance_m)
    counts = np.bincount(cell[low], minlength=side * side)
    cells = np.flatnonzero(counts)
    mean = np.bincount(cell[low], height[low], side * side)[cells] / counts[cells]
    return origin + (np.stack([cells % side, cells // side], 1) + 0.5) * fine_m, mean


def _smooth(values: F64, cells: float) -> F64:
    from scipy.ndimage import gaussian_filter  # 0.4 s: behind the imports of the programs

    return np.asarray(gaussian_filter(values, cells, mode="constant", truncate=2.5))
