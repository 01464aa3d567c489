"""The ground plane, by RANSAC among planes that can be ground, refined by least squares.

RANSAC after Fischler and Bolles (1981). The largest plane of a traffic scene is often a wall, so a plane must be nearly
level, below the layer of the ground of every lidar, and at the rig's ground height if that is
known. Its score is the number of its points beyond those in the layers just above and below it, because a wall or a
hedge fills all three.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, Bools, Indices
from lidcam.pipeline.core.clouds import Plane
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.pipeline.native.kernels import count_layers, scatter_near, scatter_within

SAMPLE_POINTS = 6000
"""Planes are sampled from, and scored on, at most this many points, every n-th of the cloud."""

THINNING = 4
"""Step through the sample on which all planes are scored."""

FINALISTS = 16
"""Number of best planes that are scored on the whole sample."""

CELL_PER_DISTANCE = 5.0
"""Planes go through the lowest points of cells this many `distance_m` wide: a wall stands on few cells."""

LAYER_PER_DISTANCE = 0.5
"""Planes are fitted to a layer thinner than the one removed: a thick one tilts towards pavements beside the road."""

STANDS_OUT = 1.5
"""Smallest ratio of points in the ground's layer to those in the fuller layer beside it; 1 for fog or a wall."""

REFINEMENTS = 6
"""Rounds of least squares on the sample, each on the points near the last plane, before one on all points."""

MAX_SHARE_BELOW = 0.005
"""Maximum share of points below a ground at the origins: level beams in a room have others below them."""

PLANES = 200
"""Planes tried."""

SEED = 0
"""Seed of the random choice of planes."""


def find_ground(
    xyz_site: F32, lidar_origins_site: F64, *, config: GroundConfig, ground_height_m: float | None = None
) -> Plane | None:
    """The ground plane; None if there is none.

    Args:
        xyz_site: (N, 3) points in the site frame, metres, finite; best as a row per coordinate in memory.
        lidar_origins_site: (L, 3) origins of the lidars in the site frame, metres; the ground is more than `distance_m`
            below each, or the level beams of a lidar in a room would be a floor. If there is none, clouds may be given
            in a frame on the ground, as `base_link` often is: then it is the plane at the origins that has no points
            below.
        config: Limits. Equal input gives equal planes.
        ground_height_m: Expected z of the ground at the site's origin; None if unknown.

    Returns:
        None if no plane within the limits stands out from the layers above and below it, or if its points form only
        a line seen from above (the foot of a wall).
    """
    plane = _ground(xyz_site, lidar_origins_site, config, ground_height_m, clearance_m=config.distance_m)
    if plane is None:
        plane = _ground(xyz_site, lidar_origins_site, config, ground_height_m, clearance_m=-config.distance_m)
        if plane is not None and _share_below(xyz_site, plane, config.distance_m) > MAX_SHARE_BELOW:
            return None
    return plane


def _share_below(xyz_site: F32, plane: Plane, distance_m: float) -> float:
    """Share of the nearer half of points that are below a plane: roads may fall off further away."""
    range_m = np.hypot(xyz_site[:, 0], xyz_site[:, 1])
    near = xyz_site[range_m <= np.median(range_m)]
    return float((near @ plane.normal + plane.offset_m < -distance_m).mean())


def _ground(
    xyz_site: F32, lidar_origins_site: F64, config: GroundConfig, ground_height_m: float | None, *, clearance_m: float
) -> Plane | None:
    """The ground that is more than `clearance_m` below each lidar."""
    layer_m = LAYER_PER_DISTANCE * config.distance_m
    points = np.ascontiguousarray(xyz_site.T)  # a row per coordinate makes heights three times faster
    sample = np.ascontiguousarray(points[:, :: max(1, -(-len(xyz_site) // SAMPLE_POINTS))])
    reachable = _within_reach(sample, config, ground_height_m)
    lowest = _lowest_of_cells(reachable, CELL_PER_DISTANCE * config.distance_m)
    if len(lowest) < 3:
        return None
    rng = np.random.Generator(np.random.PCG64(SEED))
    planes = _planes_through(reachable, lowest[rng.integers(len(lowest), size=(PLANES, 3))])
    limits = lidar_origins_site, config, ground_height_m, clearance_m
    planes = planes[_can_be_ground(planes, *limits)]
    if not len(planes):
        return None
    for scored in (np.ascontiguousarray(sample[:, ::THINNING]), sample):
        held, beside = count_layers(scored, planes.astype(np.float32), layer_m)
        planes = planes[np.argsort(beside - held, kind="stable")[:FINALISTS]]
    plane = planes[0]
    for cloud in [sample] * REFINEMENTS + [points]:
        refined = _least_squares(cloud, plane, layer_m)
        if refined is None or not _can_be_ground(refined[None], *limits)[0]:
            break
        plane = refined
    if not _is_a_floor(points, plane, layer_m):
        return None
    return Plane(plane[:3].copy(), float(plane[3]))


def _within_reach(points: F32, config: GroundConfig, ground_height_m: float | None) -> F32:
    """The points (3, N) through which a plane within the limits of height and tilt can go."""
    if ground_height_m is None:
        return points
    rise = np.tan(np.radians(config.max_tilt_deg)) * np.hypot(points[0], points[1])
    within: Bools = np.abs(points[2] - ground_height_m) <= config.height_tolerance_m + rise
    return points.compress(within, axis=1)


def _lowest_of_cells(points: F32, cell_m: float) -> Indices:
    """(M,) row of the first of the lowest points (3, N) in each cell of a square grid, ordered by cell."""
    column, line = np.floor(points[:2] / np.float32(cell_m)).astype(np.int64)
    rising = np.argsort(points[2], kind="stable")
    _, first = np.unique((column * 2**32 + line)[rising], return_index=True)
    return rising[first]


def _least_squares(points: F32, plane: F64, layer_m: float) -> F64 | None:
    """The plane (4,) fitted to the points near `plane`; None if there are fewer than 3."""
    count, centre, scatter = scatter_near(points, plane.astype(np.float32), layer_m)
    if count < 3:
        return None
    normal = np.linalg.eigh(scatter)[1][:, 0]
    normal *= -1.0 if normal[2] < 0 else 1.0
    return np.append(normal, -(normal * centre).sum())


def _is_a_floor(points: F32, plane: F64, layer_m: float) -> bool:
    """Whether a plane stands out from the layers beside it, and its points form more than a line seen from above."""
    rounded = plane.astype(np.float32)
    held, beside = count_layers(points, rounded[None], layer_m)
    if held[0] < max(3, STANDS_OUT * beside[0]):
        return False
    _, scatter = scatter_within(points, rounded, layer_m)
    return bool(np.linalg.eigvalsh(scatter[:2, :2])[0] >= layer_m**2)


def _planes_through(points: F32, triples: Indices) -> F64:
    """(up to K, 4) planes through three points each, unit normal, upwards, and offset.

    There is none where a point was drawn twice or all three lie on a line.
    """
    a, b, c = points.T.take(triples.T, axis=0).astype(np.float64).transpose(0, 2, 1)
    (ux, uy, uz), (vx, vy, vz) = b - a, c - a
    normals = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    lengths = np.sqrt((normals * normals).sum(axis=0))
    spanned = lengths > 1e-9
    normals = normals[:, spanned] / lengths[spanned]
    normals *= np.where(normals[2] < 0, -1.0, 1.0)
    return np.vstack([normals, -(normals * a[:, spanned]).sum(axis=0)]).T


def _can_be_ground(
    planes: F64, lidar_origins: F64, config: GroundConfig, ground_height_m: float | None, clearance_m: float
) -> Bools:
    """(K,) whether planes (K, 4) are level, far enough below every lidar (L, 3) and at the right height."""
    fit: Bools = planes[:, 2] >= np.cos(np.radians(config.max_tilt_deg))
    fit &= (np.einsum("ka,la->kl", planes[:, :3], lidar_origins) + planes[:, 3:]).min(axis=1) > clearance_m
    if ground_height_m is not None:  # not divided by the normal's z, which may be 0
        fit &= np.abs(planes[:, 3] + ground_height_m * planes[:, 2]) <= config.height_tolerance_m * planes[:, 2]
    return fit
