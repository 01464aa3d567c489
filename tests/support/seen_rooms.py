"""Points of lidars in a room, by right and by wrong calibration."""

import numpy as np
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64

FIRST, SECOND = np.array([-2.0, 0, 1.8]), np.array([2.0, 1, 1.6])
ROOM = np.array([[-10.0, -8, 0], [10, 8, 5]])


def seen(
    origin: F64, seed: int, *, floor_only: bool = False, beams: int = 32, step_rad: float = 0.01, noise_m: float = 0.01
) -> F64:
    """(N, 3) points of a lidar on the inner sides of a room."""
    random = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(np.arange(0.001, 2 * np.pi, step_rad), np.radians(np.linspace(-25, 10.5, beams)))
    rays = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)
    rays = rays.reshape(-1, 3)
    ranges = np.where(rays > 0, ROOM[1] - origin, ROOM[0] - origin) / rays
    nearest = ranges.argmin(1)
    points = origin + rays * (ranges.min(1) + random.normal(0, noise_m, len(rays)))[:, None]
    return np.asarray(points[(nearest == 2) & (rays[:, 2] < 0)] if floor_only else points)


def placed(points: F64, values: F64) -> F64:
    """The points of a lidar by a calibration that has this error."""
    return np.asarray((points - SECOND - values[3:]) @ Rotation.from_rotvec(values[:3]).as_matrix() + SECOND)
