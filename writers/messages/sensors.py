"""Clouds, the poses of sensors, and how cameras project, as ROS messages."""

import struct
from collections.abc import Iterable, Sequence

import numpy as np

from pipeline.core.clouds import PointCloud
from pipeline.core.geometry.pose_samples import PoseSamples
from pipeline.core.geometry.poses import interpolate_poses
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, Rig
from pipeline.core.ros.columns import Columns, Lists
from pipeline.core.ros.messages import ROS2
from pipeline.core.ros.point_kernels import packed_points
from writers.messages.parts import header, headers

__all__ = ["camera_info", "cloud_cdr", "moving_transform", "static_transforms"]

Buffer = bytes | memoryview

_CLOUD = "sensor_msgs/msg/PointCloud2"
_NAMES, _OFFSETS, _DATATYPES = ("x", "y", "z", "intensity", "ring", "time"), (0, 4, 8, 12, 16, 18), (7, 7, 7, 7, 4, 7)
"""Of the fields of a point, as in sensor_msgs/PointField."""

_POINT_BYTES = 22
_LENGTH = struct.Struct("<I")

_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def static_transforms(rig: Rig, stamp_ns: int, others: Iterable[Transform] = ()) -> Columns:
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
    return _transforms(stamp_ns, [*by_child.values()])


def moving_transform(motion: PoseSamples, stamp_ns: int) -> Columns:
    """TFMessage with the pose of the moving frame at a time that the motion covers."""
    pose = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, np.array([stamp_ns], np.int64))[0]
    return _transforms(stamp_ns, [Transform(motion.fixed_frame_id, motion.frame_id, pose)])


def _transforms(stamp_ns: int, edges: Sequence[Transform]) -> Columns:
    transforms = Columns(
        "geometry_msgs/msg/TransformStamped",
        len(edges),
        header=headers([stamp_ns] * len(edges), [edge.dst for edge in edges]),
        child_frame_id=[edge.src for edge in edges],
        transform=np.array([[*edge.translation, *edge.quaternion_xyzw] for edge in edges]).reshape(-1, 7),
    )
    return Columns("tf2_msgs/msg/TFMessage", transforms=Lists(transforms, len(edges)))


def camera_info(camera: CameraSensor, stamp_ns: int) -> Columns:
    """CameraInfo with the intrinsics that were used, for an image that is not rectified."""
    model = camera.model
    missing = max(0, _COEFFICIENTS[model.model] - len(model.distortion))
    distortion = np.pad(model.distortion, (0, missing))
    return Columns(
        "sensor_msgs/msg/CameraInfo",
        header=header(stamp_ns, camera.T_camera_site.dst),
        height=model.height_px,
        width=model.width_px,
        distortion_model=model.model,
        d=Lists(distortion, len(distortion)),
        k=model.K.reshape(1, 9),
        r=np.eye(3).reshape(1, 9),
        p=np.c_[model.K, np.zeros(3)].reshape(1, 12),
    )


def cloud_cdr(cloud: PointCloud, *, stamp_ns: int, frame_id: str) -> tuple[Buffer, ...]:
    """PointCloud2 as little-endian CDR in parts: x, y, z in metres, intensity, ring, and `time` in s after `stamp_ns`.

    Points are laid out as by Velodyne's driver.
    """
    n, xyz = len(cloud), np.ascontiguousarray(cloud.xyz)
    later_ns = float(cloud.stamp_ns - stamp_ns)
    points = packed_points(xyz.view(np.uint16), cloud.intensity, cloud.ring, cloud.time_offset_ns, later_ns)
    fields = Columns(
        "sensor_msgs/msg/PointField",
        len(_NAMES),
        name=_NAMES,
        offset=np.array(_OFFSETS),
        datatype=np.array(_DATATYPES),
        count=1,
    )
    empty = Columns(
        _CLOUD,
        header=header(stamp_ns, frame_id),
        height=1,
        width=n,
        fields=Lists(fields, len(_NAMES)),
        point_step=_POINT_BYTES,
        row_step=_POINT_BYTES * n,
        is_dense=True,
    )
    around = ROS2.serialize(empty)
    data = points.reshape(-1).view(np.uint8).data
    return bytes(around[: -_LENGTH.size - 1]) + _LENGTH.pack(len(data)), data, bytes(around[-1:])
