"""Error of one lidar's pose against another's, from common surfaces: point to plane (Chen and Medioni, 1992).

A point of the second lidar should lie in the plane of the points of the first near it. The unknowns are a small
rotation and translation of the second lidar. Directions that the surfaces do not constrain, such as along a wall, keep
their prior and its standard deviation. Points on one surface have a common error, so the covariance is clustered by
cells in space.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.calibration.motions import jackknife_covariance
from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.geometry.rotations import turned

MAX_REFERENCE_POINTS = 30_000
"""Maximum number of points of the reference lidar per frame, evenly thinned."""

TRIES = (16, 1500), (8, 3000)
"""Number of points that define a plane, and maximum number of points of the judged lidar compared per frame, evenly
thinned; the second where lidars of few beams have too little in common by the first."""

MIN_MATCHES = 100
"""Minimum number of points on common planes before two lidars are judged."""

MAX_NEIGHBOUR_DISTANCE = 0.05
"""Maximum distance of a point from those of its plane, as a share of the range: more than the spacing of the beams."""

MAX_FLATNESS = 0.02
"""Maximum ratio of a plane's smallest variance to its middle one."""

MIN_BREADTH = 0.01
"""Minimum ratio of a plane's middle variance to its largest: the points of one ring lie on a line."""

MIN_INCIDENCE = 0.05
"""Minimum sine of the angle between a plane and the beams that measure it. Range noise spreads the points of one ring
along their beams: they look like a plane that holds the beams, whatever surface they are on."""

NORMAL_TILT = 2.0
"""Variance of the tilt of a normal, in units of that from independent point errors, which they are not quite."""

ROTATION_SIGMA_RAD = 0.035
"""Prior standard deviation of each rotation, radians."""

TRANSLATION_SIGMA_M = 0.2
"""Prior standard deviation of each translation, metres."""

MIN_SIGMAS = np.array([5e-4, 5e-4, 5e-4, 5e-3, 5e-3, 5e-3])
"""Minimum standard deviations, radians and metres: planes are not quite flat, ranges not quite true."""

CELL_SIZE = 0.2
"""Size of the cells of points with a common error, as a share of the median range."""

HUBER = 1.5
"""Residual, in standard deviations, beyond which points weigh less."""

STEPS = 5
"""Number of Gauss-Newton steps."""

SIGNIFICANT_SIGMAS = 4.0
"""Minimum size of a significant error, in its standard deviations."""

MIN_ERROR = np.array([*np.radians([0.3, 0.3, 0.3]), 0.03, 0.03, 0.03])
"""Minimum size of a large error: radians, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarError:
    """The estimated error of a lidar's pose against another's."""

    # (6,) float64: rotation about the axes of the site frame, through the lidar (radians), and translation along them
    # (metres), that moves its points onto the other's surfaces
    values: F64
    covariance: F64  # (6, 6) float64
    matches: int  # Number of points on common planes

    @property
    def sigmas(self) -> F64:
        """(6,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def significant(self) -> Bools:
        """(6,) values that are significant."""
        return np.asarray(np.abs(self.values) > SIGNIFICANT_SIGMAS * self.sigmas)

    @property
    def large(self) -> Bools:
        """(6,) values that are significant and large enough to warn of."""
        return self.significant & (np.abs(self.values) > MIN_ERROR)


def lidar_error(frames: Sequence[tuple[F64, F64]], reference_site: F64, origin_site: F64) -> LidarError | None:
    """The error of a lidar against another; None if they have too little in common.

    Args:
        frames: Points (N, 3) of the reference lidar and (M, 3) of the lidar for each frame, metres in the site frame,
            without moving objects.
        reference_site: (3,) the reference lidar in the site frame, metres.
        origin_site: (3,) the lidar in the site frame, metres.
    """
    found = (_error(frames, reference_site, origin_site, *one) for one in TRIES)
    return next((error for error in found if error is not None), None)


def _error(
    frames: Sequence[tuple[F64, F64]], reference_site: F64, origin_site: F64, neighbours: int, max_points: int
) -> LidarError | None:
    from small_gicp import KdTree  # behind the imports of programs that do without

    parts = []
    for reference, points in frames:
        if len(reference) > neighbours and len(points):
            some = reference[:: -(-len(reference) // MAX_REFERENCE_POINTS)]
            chosen = points[:: -(-len(points) // max_points)]
            parts.append((KdTree(some), some, chosen, np.sqrt(((chosen - origin_site) ** 2).sum(1))))
    values, prior = np.zeros(6), 1 / np.array([ROTATION_SIGMA_RAD] * 3 + [TRANSLATION_SIGMA_M] * 3) ** 2
    for _ in range(STEPS):
        found = [_against(*part, values, reference_site, origin_site, neighbours) for part in parts]
        if sum(len(residuals) for residuals, *_ in found) < MIN_MATCHES:
            return None
        residuals, slopes, tilted, cells = (np.concatenate(columns) for columns in zip(*found, strict=True))
        sigma = max(1.4826 * float(np.median(np.abs(residuals))), 1e-4)
        weights = np.minimum(1.0, HUBER / np.maximum(np.abs(residuals) / sigma, 1e-9)) / sigma**2
        normal = np.einsum("ki,k,kj->ij", slopes, weights, slopes) + np.diag(prior)
        values = values + np.linalg.solve(normal, slopes.T @ (weights * residuals) - prior * values)
    # The normals of a floor tilt a little to all sides, which carries no information about translations along it.
    of_planes = normal - np.diag(prior) - np.einsum("kti,k,ktj->ij", tilted, weights, tilted)
    amounts, axes = np.linalg.eigh(of_planes)
    information = (axes * np.maximum(amounts, 0.0)) @ axes.T + np.diag(prior)
    scores, own = slopes * (weights * residuals)[:, None], np.einsum("k,ki,kj->kij", weights, slopes, slopes)
    gain = np.linalg.solve(information, normal)  # a step of the fit is larger where planes tell less
    covariance = gain @ jackknife_covariance(scores, own, cells, normal, prior) @ gain.T
    return LidarError(values, covariance + np.diag(MIN_SIGMAS**2), len(residuals))


def _against(
    tree: object,
    reference: F64,
    points: F64,
    ranges_m: F64,
    values: F64,
    reference_site: F64,
    origin: F64,
    neighbours: int,
) -> tuple[F64, F64, F64, I64]:
    """Points on planes: residuals (K,), derivatives (K, 6), derivatives by tilts (K, 2, 6), and cells (K, 3).

    Tilts are of one standard deviation of the normal in either direction.
    """
    arms = (points - origin) @ turned(values[:3]).T
    moved = arms + origin + values[3:]
    rows, squares = tree.batch_knn_search(moved, neighbours)  # type: ignore[attr-defined]  # KdTree, imported late
    near = reference[rows]
    middle = near.mean(1)
    spread = near - middle[:, None]
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread) / neighbours)
    normals = axes[..., 0]
    is_plane = (variances[:, 0] < MAX_FLATNESS * variances[:, 1]) & (variances[:, 1] > MIN_BREADTH * variances[:, 2])
    views = middle - reference_site
    is_plane &= np.abs((normals * views).sum(1)) > MIN_INCIDENCE * np.sqrt((views**2).sum(1))
    used = is_plane & (np.sqrt(squares[:, neighbours // 2]) < MAX_NEIGHBOUR_DISTANCE * ranges_m)
    normals, arms, moved = normals[used], arms[used], moved[used]
    tilts = np.sqrt(NORMAL_TILT / neighbours * variances[used, :1] / variances[used, 1:])
    sides = axes[used, :, 1:].swapaxes(1, 2) * tilts[..., None]
    residuals = ((middle[used] - moved) * normals).sum(1)
    cells = np.floor(moved / (CELL_SIZE * np.median(ranges_m))).astype(np.int64)
    tilted = np.concatenate([np.cross(arms[:, None], sides), sides], 2)
    return residuals, np.concatenate([np.cross(arms, normals), normals], 1), tilted, cells
