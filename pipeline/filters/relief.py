"""How the ground differs from its plane: slopes, crests, kerbs.

A surface grows from the plane outwards: the lowest points of small cells that lie near the surface pull it towards
them, smoothly, and so bring further points near. Walls and vehicles are not near, or not lowest. This is a filter of
the kind of Kraus and Pfeifer (Determination of terrain models in wooded areas with airborne laser scanner data, ISPRS
Journal 53(4), 1998), which weighs points by their height above the last surface, on a grid in place of linear
prediction. Grids are (rows along y, columns along x).
"""

from functools import cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import Plane, Relief
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.pipeline.native.kernels import grown_surface, lowest_heights

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

ABOVE_PER_DISTANCE = 0.75
"""Height above the last surface, as a multiple of `distance_m`, from which on points may stand on the ground."""

ABOVE_WEIGHT = 0.1
"""Weight of such points."""

MAX_EXTENT_PER_DISTANCE = 1.0
"""Maximum height difference of the points of a fine cell of ground, as a multiple of `distance_m`: where there is more,
and nothing near the last surface, something stands."""

MAX_POINTS = 4.0
"""Fine cells of a cell that count: no cell pulls more than one full of ground."""

PRIOR_WEIGHT = 0.05
"""Weight of the last surface against the points of a cell."""

FILL_CELLS = 5.0
"""Standard deviation, in cells, of the smoothing that fills unknown parts of the surface from known ones."""

FILL_WEIGHT = 0.02
"""Weight of the plane in those parts."""

TRUST_CELLS = 1.0
"""Standard deviation, in cells, of the smoothing of known parts' borders."""

REACH_OF_GAUSSIAN = 2.5
"""Largest reach of the smoothing, in standard deviations."""


def find_relief(xyz_site: F32, lidar_origins_site: F64, plane: Plane, config: GroundConfig) -> Relief:
    """The height of the ground above its plane.

    Args:
        xyz_site: (N, 3) points in the site frame, metres, finite; best as a row per coordinate in memory.
        lidar_origins_site: (L, 3) origins of the lidars in the site frame, metres.
        plane: The ground plane of the same points.
        config: Limits of the ground.
    """
    cell_m = CELL_PER_DISTANCE * config.distance_m
    middle = lidar_origins_site[:, :2].mean(axis=0)
    origin = middle - REACH_CELLS * cell_m
    side = 2 * REACH_CELLS + 1
    xy, height, extents_m = _lowest(xyz_site, middle, plane, origin, cell_m, config.distance_m)
    xy = (xy - origin) / cell_m
    taps = [_taps(cells) for cells in (*(spread_cells for spread_cells, _ in ROUNDS), FILL_CELLS, TRUST_CELLS)]
    offsets_m = grown_surface(
        xy,
        height,
        np.where(extents_m > MAX_EXTENT_PER_DISTANCE * config.distance_m, 0.0, ABOVE_WEIGHT),
        side,
        np.concatenate(taps),
        np.array([len(one) for one in taps]),
        np.array([reach * config.distance_m for _, reach in ROUNDS]),
        ABOVE_PER_DISTANCE * config.distance_m,
        MAX_POINTS,
        PRIOR_WEIGHT,
        FILL_WEIGHT,
    )
    return Relief(origin, cell_m, offsets_m)


def _lowest(xyz: F32, middle: F64, plane: Plane, origin: F64, cell_m: float, distance_m: float) -> tuple[F64, F64, F64]:
    """The middles of the fine cells that hold ground, perhaps (M, 2), and their lowest heights above the plane (M,).

    The last value (M,) is how much higher their highest points are.
    """
    fine_m = FINE_SHARE * cell_m
    side = round(2 * REACH_CELLS / FINE_SHARE)
    cells, heights, extents_m = lowest_heights(
        np.ascontiguousarray(xyz.T),
        np.append(plane.normal, plane.offset_m).astype(np.float32),
        middle.astype(np.float32),
        origin.astype(np.float32),
        fine_m,
        side,
        distance_m,
        MAX_SLOPE,
        LAYER_SHARE * distance_m,
    )
    return origin + (np.stack([cells % side, cells // side], 1) + 0.5) * fine_m, heights, extents_m


@cache
def _taps(cells: float) -> F64:
    """Half a Gaussian of this standard deviation, from its middle on; with the other half, its sum is 1."""
    reach = int(REACH_OF_GAUSSIAN * cells + 0.5)
    taps = np.exp(-0.5 / cells**2 * np.arange(-reach, reach + 1) ** 2)
    half: F64 = (taps / taps.sum())[reach:]
    return half
