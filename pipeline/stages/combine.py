"""Combining the clouds of all lidars in the site frame at the frame's time, and separating the ground."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, U8, Bools, Indices, join_rows
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud, Relief
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig
from lidcam.pipeline.filters.ground import find_ground
from lidcam.pipeline.filters.motion import deskew
from lidcam.pipeline.filters.outliers import neighbor_distance_m, points_in_air, statistical_inliers
from lidcam.pipeline.filters.relief import find_relief
from lidcam.pipeline.native.kernels import moved, parted


class Combine:
    """Range limits, motion compensation, extrinsics, outlier removal, ground removal.

    Every step but the extrinsics can be switched off in the settings. All fields of the points are kept. Points are in
    the order of `Rig.lidars`, and within a lidar in that of its message.

    Objects are detected in the points before outlier removal, whose single limit for all ranges would remove far and
    thin objects; only rain and snow are left out. Clustering links points by a distance that grows with range.
    """

    def __init__(self, rig: Rig, config: CombineConfig) -> None:
        self._rig = rig
        self._config = config
        self._lidar_origins_site = rig.lidar_xyz

    def __call__(self, bundle: SensorBundle, clouds: Mapping[str, PointCloud]) -> CombinedCloud:
        """The combined cloud of one frame.

        Args:
            bundle: Source of the frame's time and of the motion of the site frame, if known.
            clouds: By lidar name, in the frame of each lidar; lidars may be missing.

        Raises:
            FrameError: the motion is that of a frame other than the site frame.
        """
        config = self._config
        motion = bundle.motion_of(self._rig.site_frame) if config.motion.enabled else None

        sweeps: dict[int, PointCloud] = {}
        compensated: list[str] = []
        for index, lidar in enumerate(self._rig.lidars):
            if lidar.name in clouds:
                near = _in_range(clouds[lidar.name], config.min_range_m, config.max_range_m)
                known = _motion_over(near, bundle.stamp_ns, motion)
                sweeps[index] = _to_site(near, lidar, bundle.stamp_ns, known)
                if known is not None:
                    compensated.append(lidar.name)
        cloud = _joined([*sweeps.values()], bundle.stamp_ns, self._rig.site_frame)
        lidar_index = np.repeat(np.array([*sweeps], np.uint8), np.array([len(c) for c in sweeps.values()], np.int64))
        counts = {"input": sum(len(c) + c.nan_dropped for c in clouds.values()), "nan": cloud.nan_dropped}
        counts["range"] = counts["input"] - counts["nan"] - len(cloud)

        kept, in_air = np.ones(len(cloud), np.bool_), np.zeros(len(cloud), np.bool_)
        if config.outliers.enabled:
            distance_m = neighbor_distance_m(cloud.xyz)
            kept = statistical_inliers(distance_m, std_ratio=config.outliers.std_ratio)
            x, y, z = (cloud.xyz - self._lidar_origins_site.astype(np.float32).take(lidar_index, axis=0)).T
            in_air = points_in_air(distance_m, np.sqrt(x * x + y * y + z * z), lidar_index)

        ground = self._ground_of(cloud.xyz, kept)
        left, ground_cloud = ground.left, cloud.select(ground.on_plane)
        above = ground.above[~in_air[ground.above]]
        counts["outliers"] = len(cloud) - len(ground_cloud) - len(left)
        counts |= {"ground": len(ground_cloud), "left": len(left)}
        if in_air.any():  # left out of detection alone
            counts["rain or snow"] = len(ground.above) - len(above)

        points_by_lidar = {self._rig.lidars[index].name: len(sweep) for index, sweep in sweeps.items()}
        return CombinedCloud(
            cloud=cloud.select(left),
            detection_cloud=cloud.select(above),
            detection_lidar_index=lidar_index.take(above),
            ground_cloud=ground_cloud,
            plane=ground.plane,
            counts=counts,
            compensated=tuple(compensated),
            points_by_lidar=points_by_lidar,
            relief=ground.relief,
            ground_lidar_index=lidar_index.take(ground.on_plane),
        )

    def _ground_of(self, xyz_site: F32, kept: Bools) -> "_Ground":
        """The ground of the points that are kept."""
        config, origins, known_m = self._config.ground, self._lidar_origins_site, self._rig.ground_height_m
        plane = None
        if config.enabled:
            kept_xyz = np.ascontiguousarray(xyz_site.T).compress(kept, axis=1).T  # a row per coordinate in memory
            plane = find_ground(kept_xyz, origins, config=config, ground_height_m=known_m)
        if plane is None:
            return _Ground(None, None, np.flatnonzero(kept), np.arange(0), np.arange(len(xyz_site)))
        relief = find_relief(kept_xyz, origins, plane, config)
        rounded = np.append(plane.normal, plane.offset_m).astype(np.float32)
        grid = (relief.origin_xy, relief.cell_m, relief.offsets_m)
        return _Ground(plane, relief, *parted(xyz_site, kept, rounded, config.distance_m, *grid))


class _Ground(NamedTuple):
    """The ground, and rows of points by it."""

    plane: Plane | None  # None if there is none
    relief: Relief | None  # Deviation of the ground from the plane
    left: Indices  # Kept points that are not near the plane
    on_plane: Indices  # Kept points near the plane
    above: Indices  # Points that are not near the actual ground, kept or not


def _in_range(cloud: PointCloud, min_range_m: float, max_range_m: float) -> PointCloud:
    """Points whose distance from the lidar is within the limits, both inclusive.

    Points at the lidar itself are removed: some drivers write beams without a return as (0, 0, 0).
    """
    x, y, z = cloud.xyz.T
    with np.errstate(over="ignore"):  # of points that are infinitely far in float32
        range_m = np.sqrt(x * x + y * y + z * z)
    keep = (range_m > 0) & (range_m >= np.float32(min_range_m)) & (range_m <= np.float32(max_range_m))
    return cloud if keep.all() else cloud.select(keep)


def _motion_over(cloud: PointCloud, stamp_ns: int, motion: PoseSamples | None) -> PoseSamples | None:
    """The motion, if points have to be moved to the frame's time and it is known for all of them."""
    # Without point times, a cloud with the stamp of the frame needs no compensation.
    if motion is None or not len(cloud) or not (cloud.has_time or cloud.stamp_ns != stamp_ns):
        return None
    ends_ns = (cloud.stamp_ns + int(end) for end in (cloud.time_offset_ns.min(), cloud.time_offset_ns.max()))
    return motion if motion.covers(stamp_ns, *ends_ns) else None


def _to_site(cloud: PointCloud, lidar: LidarSensor, stamp_ns: int, motion: PoseSamples | None) -> PointCloud:
    """The cloud in the site frame, moved to the frame's time if the motion is given."""
    offset_ns, later_ns = cloud.time_offset_ns, cloud.stamp_ns - stamp_ns
    xyz_site = moved(np.ascontiguousarray(cloud.xyz), lidar.T_site_lidar.matrix[:3].astype(np.float32))
    if motion is not None:
        xyz_site = deskew(xyz_site, cloud.stamp_ns + offset_ns.astype(np.int64), stamp_ns, motion)
    if later_ns:
        int32 = np.iinfo(np.int32)  # saturates 2.1 s away
        offset_ns = np.clip(offset_ns.astype(np.int64) + later_ns, int32.min, int32.max).astype(np.int32)
    return replace(cloud, stamp_ns=stamp_ns, frame_id=lidar.T_site_lidar.dst, xyz=xyz_site, time_offset_ns=offset_ns)


def _joined(clouds: list[PointCloud], stamp_ns: int, site_frame: str) -> PointCloud:
    """All clouds as one; each has the stamp and the frame already."""
    if len(clouds) == 1:
        return clouds[0]
    return replace(
        join_rows(PointCloud.zeros(stamp_ns=stamp_ns, frame_id=site_frame), *clouds),
        has_time=bool(clouds) and all(cloud.has_time for cloud in clouds),
        nan_dropped=sum(cloud.nan_dropped for cloud in clouds),
        return_type=_return_types(clouds),
    )


def _return_types(clouds: list[PointCloud]) -> U8 | None:
    """Return types by point, 0 if its lidar does not report them; None if no lidar does."""
    if all(cloud.return_type is None for cloud in clouds):
        return None
    return np.concatenate([np.zeros(len(c), np.uint8) if c.return_type is None else c.return_type for c in clouds])
