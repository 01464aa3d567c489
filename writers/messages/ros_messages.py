"""The parts that ROS messages share, transforms, and calibration, as message objects for rosbags' serialiser."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from rosbags.typesys.stores.ros2_humble import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Quaternion as Quaternion
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Transform as TransformMsg
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__TransformStamped as TransformStamped
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_humble import sensor_msgs__msg__CameraInfo as CameraInfo
from rosbags.typesys.stores.ros2_humble import sensor_msgs__msg__RegionOfInterest as RegionOfInterest
from rosbags.typesys.stores.ros2_humble import std_msgs__msg__Header as Header
from rosbags.typesys.stores.ros2_humble import tf2_msgs__msg__TFMessage as TFMessage

from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.pose_samples import PoseSamples
from pipeline.core.geometry.poses import interpolate_poses
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, Rig

__all__ = ["box_poses", "camera_info", "header", "moving_transform", "static_transforms", "time", "vectors"]

_COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def time(stamp_ns: int) -> Time:
    """builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return Time(seconds, nanoseconds)


def header(stamp_ns: int, frame_id: str) -> Header:
    """std_msgs/Header."""
    return Header(time(stamp_ns), frame_id)


def vectors(rows: Iterable[Iterable[float]]) -> list[Vector3]:
    """A geometry_msgs/Vector3 for each row x, y, z."""
    return [Vector3(x, y, z) for x, y, z in rows]


def box_poses(boxes: Boxes3D) -> list[Pose]:
    """Centre and heading of each box."""
    half = boxes.yaws / 2
    turns = zip(np.sin(half).tolist(), np.cos(half).tolist(), strict=True)
    return [
        Pose(Point(x, y, z), Quaternion(0.0, 0.0, sin, cos))
        for (x, y, z), (sin, cos) in zip(boxes.centers.tolist(), turns, strict=True)
    ]


def static_transforms(rig: Rig, stamp_ns: int) -> TFMessage:
    """The site frame to every sensor's frame, each child once; a sensor in the site frame itself needs none."""
    edges = [lidar.T_site_lidar for lidar in rig.lidars]
    edges += [camera.T_camera_site.inverse() for camera in rig.cameras]
    by_child: dict[str, Transform] = {}
    for edge in edges:
        if edge.src != edge.dst:
            by_child.setdefault(edge.src, edge)
    return TFMessage([_transform_stamped(edge, stamp_ns) for edge in by_child.values()])


def moving_transform(motion: PoseSamples, stamp_ns: int) -> TFMessage:
    """The pose of the moving frame at a time that the motion covers."""
    pose = interpolate_poses(motion.stamps_ns, motion.T_fixed_moving, np.array([stamp_ns], np.int64))[0]
    return TFMessage([_transform_stamped(Transform(motion.fixed_frame_id, motion.frame_id, pose), stamp_ns)])


def camera_info(camera: CameraSensor, stamp_ns: int) -> CameraInfo:
    """The intrinsics that were used; P is [K | 0]: the images are as recorded, not rectified."""
    model = camera.model
    padding = max(0, _COEFFICIENTS[model.model] - len(model.distortion))
    return CameraInfo(
        header=header(stamp_ns, camera.T_camera_site.dst),
        height=model.height_px,
        width=model.width_px,
        distortion_model=model.model,
        d=np.pad(np.asarray(model.distortion, np.float64), (0, padding)),
        k=np.asarray(model.K, np.float64).reshape(9),
        r=np.eye(3).reshape(9),
        p=np.hstack([model.K, np.zeros((3, 1))]).reshape(12),
        binning_x=0,
        binning_y=0,
        roi=RegionOfInterest(0, 0, 0, 0, False),
    )


def _transform_stamped(transform: Transform, stamp_ns: int) -> Any:
    x, y, z, w = transform.quaternion_xyzw.tolist()
    return TransformStamped(
        header(stamp_ns, transform.dst),
        transform.src,
        TransformMsg(Vector3(*transform.translation.tolist()), Quaternion(x, y, z, w)),
    )
