"""Clouds, the poses of sensors, and how cameras project, as ROS messages."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from pipeline.core.clouds import PointCloud
from pipeline.core.geometry.pose_samples import PoseSamples
from pipeline.core.geometry.poses import interpolate_poses
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.ros.messages import ROS2

__all__ = ["camera_info", "moving_transform", "point_cloud2", "static_transforms"]

_POINT = np.dtype([("xyz", "V12"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
_POINT_FIELDS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)]
"""Name, offset and datatype of each field of a point, as in sensor_msgs/PointField."""

_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def static_transforms(rig: Rig, stamp_ns: int, others: Iterable[Transform] = ()) -> Any:
    """TFMessage from the site frame to every sensor's frame, each child once; the site frame itself needs none.

    Args:
        rig: The sensors.
        stamp_ns: Stamp of the transforms.
        others: T_site_frame of further frames.
    """
    edges = [lidar.T_site_lidar for lidar in rig.lidars]
    edges += [camera.T_camera_site.inverse() for camera in rig.cameras]
    by_child: dict[str, Transform] = {}
    for edge in (*edges, *others):
        if edge.src != edge.dst:
            by_child.setdefault(edge.src, edge)
    return ROS2.transforms(stamp_ns, by_child.values())


def moving_transform(motion: PoseSamples, stamp_ns: int) -> Any:
    """TFMessage with the pose of the moving frame at a time that the motion covers."""
    pose = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, np.array([stamp_ns], np.int64))[0]
    return ROS2.transforms(stamp_ns, [Transform(motion.fixed_frame_id, motion.frame_id, pose)])


def camera_info(camera: CameraSensor, stamp_ns: int) -> Any:
    """CameraInfo with the intrinsics that were used."""
    model = camera.model
    padding = max(0, _COEFFICIENTS[model.model] - len(model.distortion))
    return ROS2.camera_info(
        stamp_ns,
        camera.T_camera_site.dst,
        width=model.width_px,
        height=model.height_px,
        distortion_model=model.model,
        d=np.pad(model.distortion, (0, padding)),
        k=model.K.reshape(9),
    )


def point_cloud2(cloud: PointCloud, *, stamp_ns: int, frame_id: str) -> Any:
    """x, y, z in metres, intensity, ring, and `time` in seconds after `stamp_ns`, laid out as by Velodyne's driver."""
    time_s = ((cloud.time_offset_ns + float(cloud.stamp_ns - stamp_ns)) * 1e-9).astype(np.float32)
    points = np.empty(len(cloud), _POINT)
    points["xyz"] = np.ascontiguousarray(cloud.xyz).view("V12")[:, 0]  # whole points are quicker than columns
    points["intensity"], points["ring"], points["time"] = cloud.intensity, cloud.ring, time_s
    return ROS2.point_cloud2(stamp_ns, frame_id, _POINT_FIELDS, points.view(np.uint8), point_step=_POINT.itemsize)
