"""Errors of one lidar's pose against another's, by what both see: point to plane (Chen and Medioni, 1992).

A point of the second lidar should lie in the plane of the points of the first that are near it. Unknown are a small
rotation and translation of the second lidar. What the surfaces do not tell, such as the way along a wall, keeps its
prior, and its standard deviation says so. Points on one surface err alike, so the covariance is that of clusters: all
points of a cell in space.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.calibration.motions import cluster_covariance, turned
from lidcam.pipeline.core.arrays import F64, I64

MAX_POINTS, MAX_OTHERS, NEIGHBOURS = 1500, 30_000, 16
"""Points of the second lidar that are compared in each frame, and of the first, every n-th of them; points of a
plane."""

MIN_MATCHES = 200
"""Two lidars with fewer points on common planes are not judged."""

GATE = 0.05
"""How far from its plane's points a point may lie, as a share of its distance from the lidar: more than the beams of a
lidar are apart."""

FLAT, BROAD = 0.02, 0.01
"""A plane's smallest variance as a share of the middle one, at most; and the middle one as a share of the largest, at
least: points of one ring of a lidar lie on a line, and say nothing of the plane."""

TILT = 2.0
"""Variance of a normal's tilt, in units of what independent errors of the points would make: they are not quite so."""

ROTATION_RAD, MOVE_M = 0.035, 0.2
"""Standard deviations before anything is seen."""

FLOORS = np.array([5e-4, 5e-4, 5e-4, 5e-3, 5e-3, 5e-3])
"""An error is not known better than so: planes are not quite flat, ranges not quite true. Radians, metres."""

CELLS = 0.2
"""Cells in space as a share of the distance from the lidar, roughly."""

HUBER, STEPS = 1.5, 5


@dataclass(frozen=True, slots=True, eq=False)
class LidarError:
    """What common surfaces say of a lidar's pose against another's.

    Attributes:
        values: (6,) float64: rotation about the axes of the site frame, through the lidar (radians), and translation
            along them (metres), that would lay its points onto the other's surfaces.
        sigmas: (6,) float64, their standard deviations.
        matches: Number of points on common planes.
    """

    values: F64
    sigmas: F64
    matches: int


def lidar_error(frames: Sequence[tuple[F64, F64]], origin_site: F64) -> LidarError | None:
    """The error of a lidar against another; None if they have too little in common.

    Args:
        frames: Of each frame, points (N, 3) of the other lidar and (M, 3) of the lidar, metres in the site frame,
            without what moves.
        origin_site: (3,) the lidar in the site frame, metres.
    """
    from scipy.spatial import cKDTree  # costs every start of the program, and few lidars have a second

    parts = []
    for others, points in frames:
        if len(others) > NEIGHBOURS and len(points):
            some, chosen = others[:: -(-len(others) // MAX_OTHERS)], points[:: -(-len(points) // MAX_POINTS)]
            parts.append((cKDTree(some), some, chosen, np.sqrt(((chosen - origin_site) ** 2).sum(1))))
    values, prior = np.zeros(6), 1 / np.array([ROTATION_RAD] * 3 + [MOVE_M] * 3) ** 2
    for _ in range(STEPS):
        found = [_against(*part, values, origin_site) for part in parts]
        if sum(len(away) for away, *_ in found) < MIN_MATCHES:
            return None
        away, slopes, tilted, cells = (np.concatenate(columns) for columns in zip(*found, strict=True))
        sigma = max(1.4826 * float(np.median(np.abs(away))), 1e-4)
        weights = np.minimum(1.0, HUBER / np.maximum(np.abs(away) / sigma, 1e-9)) / sigma**2
        normal = np.einsum("ki,k,kj->ij", slopes, weights, slopes) + np.diag(prior)
        values = values + np.linalg.solve(normal, slopes.T @ (weights * away) - prior * values)
    known = _known(normal - np.diag(prior), tilted, weights) + np.diag(prior)
    covariance = cluster_covariance(slopes * (weights * away)[:, None], cells, known, prior)
    return LidarError(values, np.hypot(np.sqrt(np.diag(covariance)), FLOORS), len(away))


def _known(found: F64, tilted: F64, weights: F64) -> F64:
    """(6, 6) information of the planes, without what only the noise of their normals makes of it.

    The normals of a floor tilt a little to all sides. That says nothing of the way along the floor.
    """
    values, axes = np.linalg.eigh(found - np.einsum("kti,k,ktj->ij", tilted, weights, tilted))
    return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)


def _against(
    tree: object, others: F64, points: F64, ranges_m: F64, values: F64, origin: F64
) -> tuple[F64, F64, F64, I64]:
    """The points on planes: how far away the planes are (K,), derivatives (K, 6), those of tilts, and cells (K, 3).

    Those of tilts (K, 2, 6) are of what a standard deviation adds to the normal in either direction.
    """
    arms = (points - origin) @ turned(values[:3]).T
    moved = arms + origin + values[3:]
    distances, rows = tree.query(moved, k=NEIGHBOURS)  # type: ignore[attr-defined]  # cKDTree, imported late
    near = others[rows]
    middle = near.mean(1)
    spread = near - middle[:, None]
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread) / NEIGHBOURS)
    normals = axes[..., 0]
    is_plane = (variances[:, 0] < FLAT * variances[:, 1]) & (variances[:, 1] > BROAD * variances[:, 2])
    used = is_plane & (distances[:, NEIGHBOURS // 2] < GATE * ranges_m)
    normals, arms, moved = normals[used], arms[used], moved[used]
    tilts = np.sqrt(TILT / NEIGHBOURS * variances[used, :1] / variances[used, 1:])
    sides = axes[used, :, 1:].swapaxes(1, 2) * tilts[..., None]
    away = ((middle[used] - moved) * normals).sum(1)
    cells = np.floor(moved / (CELLS * np.median(ranges_m))).astype(np.int64)
    tilted = np.concatenate([np.cross(arms[:, None], sides), sides], 2)
    return away, np.concatenate([np.cross(arms, normals), normals], 1), tilted, cells
