"""A lidar over flat ground that sees boxes, in plain numpy: point clouds whose truth is known."""

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud, Relief
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig

Box = tuple[float, float, float, float, float, float, float]
"""x, y, z of the centre, length, width, height, yaw."""


def scan(
    origin: tuple[float, float, float],
    boxes: list[Box],
    *,
    rings: tuple[float, float, int] = (-24.8, 2.0, 64),
    noise_m: float = 0.0,
) -> F64:
    """(N, 3) first hits on the boxes of the beams of a spinning lidar, site frame; `rings` is lowest, highest, number.

    Only beams that can hit a box are cast. Noise along the beam is drawn with a fixed seed.
    """
    elevation = np.deg2rad(np.linspace(*rings))
    azimuth = np.deg2rad(np.arange(0.0, 360.0, 0.2))
    el, az = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
    beams = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], 1)
    nearest = np.full(len(beams), np.inf)
    for x, y, z, length, width, height, yaw in boxes:
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        start, direction = turn @ (np.array(origin) - (x, y, z)), beams @ turn.T
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (np.array([sign * s / 2 for s in (length, width, height)]) - start for sign in (-1, 1))
            enter, leave = np.minimum(one / direction, two / direction), np.maximum(one / direction, two / direction)
        near, far = enter.max(1), leave.min(1)
        nearest = np.where((near <= far) & (near > 0) & (near < nearest), near, nearest)
    hit = np.isfinite(nearest)
    distance = nearest[hit] + noise_m * np.random.default_rng(0).standard_normal(int(hit.sum()))
    return np.asarray(origin + beams[hit] * distance[:, None])


def turned(points: F64, yaw: float, shift: tuple[float, float]) -> F64:
    """Points (..., 3) turned about the site's z axis, then shifted along x and y."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.asarray(points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + np.array([*shift, 0.0]))


def rig(*origins: tuple[float, float, float]) -> Rig:
    """A rig of lidars at the given places."""
    poses = {f"lidar{row}": pose_matrix(np.eye(3), origin) for row, origin in enumerate(origins)}
    lidars = (LidarSensor(name, f"/{name}", Transform("site", name, pose)) for name, pose in poses.items())
    return Rig("site", tuple(lidars), (), (), 0.0)


def combined(*clouds: F64, plane: Plane | None = None, relief: Relief | None = None) -> CombinedCloud:
    """What `Combine` would hand on: the points of each lidar of the rig in turn, the ground taken away."""
    xyz = np.concatenate(
        [np.zeros((0, 3), np.float32), *(np.asarray(cloud, np.float32).reshape(-1, 3) for cloud in clouds)]
    )
    lidar = np.repeat(np.arange(len(clouds), dtype=np.uint8), np.array([len(cloud) for cloud in clouds], int))
    nothing = point_cloud(np.zeros((0, 3)))
    return CombinedCloud(point_cloud(xyz), point_cloud(xyz), lidar, nothing, plane, {}, relief=relief)


def point_cloud(xyz: npt.ArrayLike, frame_id: str = "site") -> PointCloud:
    """A cloud of points (N, 3) without intensities, rings and times."""
    points = np.array(xyz, np.float32)
    n = len(points)
    return PointCloud(7, frame_id, points, np.zeros(n, np.float32), np.zeros(n, np.uint16), np.zeros(n, np.int32))
