"""The ground plane, by RANSAC among planes that can be ground, refined by least squares.

RANSAC after Fischler and Bolles (1981). The largest plane of a traffic scene is often a wall, so a plane must be nearly
level, below every lidar, and at the rig's ground height if that is known. Its score is the number of its points beyond
those in the layers just above and below it, because a wall or a hedge fills all three.
"""

from typing import Protocol

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.clouds import Plane
from pipeline.core.settings.combine import GroundConfig
from pipeline.filters import ground_arrays

__all__ = ["GroundPasses", "find_ground"]


SAMPLE_POINTS = 6000
"""Planes are sampled from, and scored on, at most this many points, every n-th of the cloud."""

THINNING, FINALISTS = 4, 16
"""All planes are scored on every fourth point of the sample, the best of them on the whole sample."""

CELL_PER_DISTANCE = 5.0
"""Planes go through the lowest points of cells this many `distance_m` wide: a wall stands on few cells."""

LAYER_PER_DISTANCE = 0.5
"""Planes are fitted to a layer thinner than the one removed: a thick one tilts towards pavements beside the road."""

STANDS_OUT = 1.5
"""Smallest ratio of points in the ground's layer to those in the fuller layer beside it; 1 for fog or a wall."""

REFINEMENTS = 6
"""Rounds of least squares on the sample, each on the points near the last plane, before one on all points."""


class GroundPasses(Protocol):
    """What is done with all points: `pipeline.filters.ground_arrays` explains it, `ground_passes` is the fast one."""

    def lowest_of_cells(self, points: F32, cell_m: np.float32) -> I64: ...  # noqa: D102
    def planes_through(self, points: F32, triples: I64) -> F64: ...  # noqa: D102
    def can_be_ground(self, planes: F64, lidar_origins: F64, limits: F64) -> Bools: ...  # noqa: D102
    def count_layers(self, points: F32, planes: F32, layer_m: np.float32) -> tuple[I64, I64]: ...  # noqa: D102
    def scatter_within(self, points: F32, plane: F32, limit_m: np.float32) -> tuple[F64, F64]: ...  # noqa: D102
    def scatter_near(self, points: F32, plane: F32, layer_m: np.float32) -> tuple[int, F64, F64]: ...  # noqa: D102


def find_ground(
    xyz_site: F32,
    lidar_origins_site: F64,
    *,
    config: GroundConfig,
    ground_height_m: float | None = None,
    passes: GroundPasses = ground_arrays,
) -> Plane | None:
    """The ground plane; None if there is none.

    Args:
        xyz_site: (N, 3) points in the site frame, metres, finite; best as a row per coordinate in memory.
        lidar_origins_site: (L, 3) origins of the lidars in the site frame, metres; the ground is below each.
        config: Limits, number of planes and seed. Equal input gives equal planes.
        ground_height_m: Expected z of the ground at the site's origin; None if unknown.
        passes: How to go through all points; the planes are the same but for rounding.

    Returns:
        None if no plane within the limits stands out from the layers above and below it, or if its points form only
        a line seen from above (the foot of a wall).
    """
    layer_m = np.float32(LAYER_PER_DISTANCE * config.distance_m)
    points = np.ascontiguousarray(xyz_site.T)  # a row per coordinate makes heights three times faster
    sample = np.ascontiguousarray(points[:, :: max(1, -(-len(xyz_site) // SAMPLE_POINTS))])
    reachable = _within_reach(sample, config, ground_height_m)
    lowest = passes.lowest_of_cells(reachable, np.float32(CELL_PER_DISTANCE * config.distance_m))
    if len(lowest) < 3:
        return None
    rng = np.random.Generator(np.random.PCG64(config.seed))
    planes = passes.planes_through(reachable, lowest[rng.integers(len(lowest), size=(config.iterations, 3))])
    limits = _limits(config, ground_height_m)
    planes = planes[passes.can_be_ground(planes, lidar_origins_site, limits)]
    if not len(planes):
        return None
    for scored in (np.ascontiguousarray(sample[:, ::THINNING]), sample):
        held, beside = passes.count_layers(scored, planes.astype(np.float32), layer_m)
        planes = planes[np.argsort(beside - held, kind="stable")[:FINALISTS]]
    plane = planes[0]
    for cloud in [sample] * REFINEMENTS + [points]:
        refined = _least_squares(cloud, plane, layer_m, passes)
        if refined is None or not passes.can_be_ground(refined[None], lidar_origins_site, limits)[0]:
            break
        plane = refined
    if not _is_a_floor(points, plane, layer_m, passes):
        return None
    return Plane(plane[:3].copy(), float(plane[3]))


def _within_reach(points: F32, config: GroundConfig, ground_height_m: float | None) -> F32:
    """The points (3, N) through which a plane within the limits of height and tilt can go."""
    if ground_height_m is None:
        return points
    rise = np.tan(np.radians(config.max_tilt_deg)) * np.hypot(points[0], points[1])
    within: Bools = np.abs(points[2] - ground_height_m) <= config.height_tolerance_m + rise
    return points.compress(within, axis=1)


def _limits(config: GroundConfig, ground_height_m: float | None) -> F64:
    """(3,) what `can_be_ground` asks of planes: least z of the normal, expected height, its tolerance."""
    level = np.cos(np.radians(config.max_tilt_deg))
    if ground_height_m is None:
        return np.array([level, 0.0, np.inf])
    return np.array([level, ground_height_m, config.height_tolerance_m])


def _least_squares(points: F32, plane: F64, layer_m: np.float32, passes: GroundPasses) -> F64 | None:
    """The plane (4,) fitted to the points near `plane`; None if there are fewer than 3."""
    count, centre, scatter = passes.scatter_near(points, plane.astype(np.float32), layer_m)
    if count < 3:
        return None
    normal = np.linalg.eigh(scatter)[1][:, 0]
    normal *= -1.0 if normal[2] < 0 else 1.0
    return np.append(normal, -(normal * centre).sum())


def _is_a_floor(points: F32, plane: F64, layer_m: np.float32, passes: GroundPasses) -> bool:
    """Whether a plane stands out from the layers beside it, and its points form more than a line seen from above."""
    rounded = plane.astype(np.float32)
    held, beside = passes.count_layers(points, rounded[None], layer_m)
    if held[0] < max(3, STANDS_OUT * beside[0]):
        return False
    _, scatter = passes.scatter_within(points, rounded, layer_m)
    return bool(np.linalg.eigvalsh(scatter[:2, :2])[0] >= float(layer_m) ** 2)
