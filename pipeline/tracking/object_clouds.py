"""The points of tracked objects, gathered over frames, each object's in its own frame.

The frame of an object has its origin in the centre of its box, x forward along its heading, y left, z up. Points of a
frame are placed by the pose that the track has there, then registered to what the track has so far by small_gicp
(generalized ICP, Segal et al., RSS 2009). One point a voxel is kept, so memory is bounded.
"""

from collections.abc import Iterator

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.detections import Fused, Source
from lidcam.pipeline.core.tracks import NO_TRACK

MARGIN = 0.1
"""Extra length, width and height within which points belong to an object, as shares; none at the ground."""

VOXELS_PER_SIZE = 100
"""Number of voxels along the largest side of an object: 4.5 cm for cars, 3 mm for models of 1:14."""

MAX_VOXEL_M = 0.05
"""Maximum side of a voxel, metres."""

VOXEL_GROWTH = 1.25
"""Growth of the voxels of a cloud that has too many points."""

MIN_NEW, MIN_KNOWN = 30, 100
"""Minimum number of points that are registered, and of those that they are registered to."""

REGISTERED_VOXELS = 2
"""Size of the voxels for registration, in voxels of the cloud."""

MIN_INLIERS = 0.5
"""Minimum share of points with a counterpart in a sound registration."""

MAX_SHIFT_SHARE = 0.03
"""Maximum shift by a registration, as a share of the length of the object."""

MAX_TURN_RAD = np.radians(3)
"""Maximum turn by a registration, radians."""

MAX_STANDING_SPEED = 0.05
"""Maximum speed of a standing object, in lengths per second; its pose is the same in all frames."""


class ObjectCloud:
    """The points of one object so far.

    Attributes:
        stamp_ns: Origin of the times.
        voxel_m: Side of the voxels, of which each has one point at most.
        points: (N, 5) float32: x, y, z in the object's frame, intensity in the sensor's own scale, seconds after
            `stamp_ns`. In the order of their voxels.
    """

    def __init__(self, stamp_ns: int, voxel_m: float, points: F32 | None = None) -> None:
        """An empty cloud, or one that is to go on, with the points that it had."""
        self.stamp_ns, self.voxel_m = stamp_ns, voxel_m
        self.points = np.zeros((0, 5), np.float32) if points is None else points

    def add(self, points: F64, size: F64, *, moves: bool, max_points: int) -> None:
        """Add the points of one frame.

        Args:
            points: (M, 5) as `ObjectCloud.points`, but with the time in seconds after the epoch of `stamp_ns`.
            size: (3,) length, width and height of the object.
            moves: Whether the object moves, so that the poses of its track differ from frame to frame.
            max_points: The cloud has no more points than this; its voxels grow as needed.
        """
        if moves and len(points) >= MIN_NEW and len(self.points) >= MIN_KNOWN:
            xyz = self._registered(points[:, :3], float(size[0]))
            points = np.column_stack([xyz, points[:, 3:]])[_depth(xyz, size) <= 1]
        self.points = _thinned(np.concatenate([self.points, points.astype(np.float32)]), self.voxel_m)
        while len(self.points) > max_points:
            self.voxel_m *= VOXEL_GROWTH
            self.points = _thinned(self.points, self.voxel_m)

    def _registered(self, xyz: F64, length_m: float) -> F64:
        """Points where they fit best to the cloud; as they are if that is not to be relied on. One thread only."""
        from small_gicp import align, preprocess_points

        voxel_m = REGISTERED_VOXELS * self.voxel_m
        known, tree = preprocess_points(self.points[:, :3].astype(np.float64), voxel_m, num_threads=1)
        new, _ = preprocess_points(xyz, voxel_m, num_threads=1)
        if new.size() < MIN_NEW:
            return xyz
        reach_m = MAX_SHIFT_SHARE * length_m + voxel_m
        found = align(
            known,
            new,
            tree,
            max_correspondence_distance=reach_m,
            num_threads=1,
            translation_epsilon=1e-2 * self.voxel_m,
        )
        T = found.T_target_source
        shift_m, turn_rad = np.linalg.norm(T[:3, 3]), np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
        is_sound = found.converged and found.num_inliers >= MIN_INLIERS * new.size()
        if not is_sound or shift_m > MAX_SHIFT_SHARE * length_m or turn_rad > MAX_TURN_RAD:
            return xyz
        return np.asarray(xyz @ T[:3, :3].T + T[:3, 3])


def voxel_of(size: F64) -> float:
    """Side of the voxels of an object of this size (3,), metres."""
    return min(float(size.max()) / VOXELS_PER_SIZE, MAX_VOXEL_M)


def points_in_objects(fused: Fused, cloud: PointCloud) -> Iterator[tuple[int, F64, I64, bool]]:
    """The points of each tracked object that the lidars see in a frame, by rising row.

    A point counts where the object was at the point's own time, and for one object only: of several, that in whose
    box it lies deepest.

    Args:
        fused: The objects of the frame, with tracks.
        cloud: The points of the frame without those of the ground, in the same frame; `stamp_ns` is that of the frame.

    Yields:
        The object's row, (M, 3) float64 points in its frame, (M,) their rows in the cloud, and whether it moves.
    """
    objects, tracks = fused.objects, fused.tracks
    if tracks is None:
        return
    by_lidars = np.isin(objects.sources, [Source.LIDAR.value, Source.BOTH.value])
    rows = np.flatnonzero(by_lidars & (tracks.ids != NO_TRACK))
    seconds = cloud.time_offset_ns / 1e9
    longest_s = float(np.abs(seconds).max(initial=0.0))
    owners, depths = np.full(len(cloud), -1), np.ones(len(cloud))
    found = {}
    for row in rows.tolist():
        center, size, velocity = objects.centers[row], objects.sizes[row], tracks.velocities[row]
        reach_m = (1 + MARGIN) * np.hypot(*size[:2]) / 2 + longest_s * tracks.speeds[row]
        near = np.flatnonzero((np.abs(cloud.xyz[:, :2] - center[:2].astype(np.float32)) < reach_m).all(1))
        away = cloud.xyz[near].astype(np.float64) - center
        away[:, :2] -= seconds[near, None] * velocity
        yaws = objects.yaws[row] + seconds[near] * tracks.yaw_rates[row]
        cos, sin = np.cos(yaws), np.sin(yaws)
        xyz = np.column_stack([away[:, 0] * cos + away[:, 1] * sin, away[:, 1] * cos - away[:, 0] * sin, away[:, 2]])
        depth = _depth(xyz, size)
        deepest = depth <= depths[near]
        near = near[deepest]
        owners[near], depths[near] = row, depth[deepest]
        found[row] = near, xyz[deepest]
    for row, (near, xyz) in found.items():
        is_own = owners[near] == row
        moves = tracks.speeds[row] > MAX_STANDING_SPEED * objects.sizes[row, 0]
        yield row, xyz[is_own], near[is_own], bool(moves)


def _depth(xyz: F64, size: F64) -> F64:
    """(M,) how near points are to the edge of a box around the origin, with its margin: 0 at the centre, 1 there."""
    half = (1 + MARGIN) * size / 2
    return np.asarray(np.maximum(np.abs(xyz / half).max(1), -xyz[:, 2] / (size[2] / 2)))


def _thinned(points: F32, voxel_m: float) -> F32:
    """The first point of each voxel, in the order of the voxels."""
    cells = np.floor(points[:, :3].astype(np.float64) / voxel_m).astype(np.int64) + (1 << 20)
    keys = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return np.asarray(points[np.unique(keys, return_index=True)[1]])
