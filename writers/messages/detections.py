"""Objects as messages for programs: vision_msgs (branch ros2), and MsgLidCam of the predecessor system."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone, default_zones
from pipeline.core.ros.messages import ROS2

__all__ = ["box_poses", "detections_2d", "detections_3d", "lidcam_objects"]

# Rows of a 6 x 6 covariance over x, y, z and the rotations about x, y, z that Boxes3D.covariances has.
_X_Y_YAW = np.array([0, 1, 5])


def box_poses(boxes: Boxes3D) -> list[Any]:
    """The geometry_msgs/Pose of each box: its centre and heading."""
    half = boxes.yaws / 2
    turns = zip(np.sin(half).tolist(), np.cos(half).tolist(), strict=True)
    return [
        ROS2.pose(center, (0.0, 0.0, sin, cos))
        for center, (sin, cos) in zip(boxes.centers.tolist(), turns, strict=True)
    ]


def detections_3d(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """vision_msgs/Detection3DArray: class name, score, pose with the covariance of x, y and yaw, full size.

    `id` is empty: nothing is tracked.
    """
    covariances = np.zeros((len(boxes), 6, 6))
    covariances[:, _X_Y_YAW[:, None], _X_Y_YAW] = boxes.covariances
    columns = zip(
        box_poses(boxes),
        boxes.sizes.tolist(),
        boxes.scores.tolist(),
        boxes.class_ids.tolist(),
        covariances.reshape(-1, 36),
        strict=True,
    )
    header, new = ROS2.header(stamp_ns, boxes.frame_id), ROS2.new
    detections = []
    for pose, size, score, class_id, covariance in columns:
        result = _result(class_names[class_id], score, ROS2.pose_with_covariance(pose, covariance))
        box = new("vision_msgs/msg/BoundingBox3D", pose, ROS2.vector(*size))
        detections.append(new("vision_msgs/msg/Detection3D", header, [result], box, ""))
    return new("vision_msgs/msg/Detection3DArray", header, detections)


def detections_2d(boxes: Boxes2D, class_names: Sequence[str], *, stamp_ns: int, frame_id: str) -> Any:
    """vision_msgs/Detection2DArray: class name, score, centre and size in pixels from the top left corner."""
    header, new = ROS2.header(stamp_ns, frame_id), ROS2.new
    no_pose = ROS2.pose_with_covariance(ROS2.pose((0.0, 0.0, 0.0)))
    xyxy = boxes.xyxy.astype(np.float64)
    centers, sizes = (xyxy[:, :2] + xyxy[:, 2:]) / 2, xyxy[:, 2:] - xyxy[:, :2]
    columns = zip(centers.tolist(), sizes.tolist(), boxes.scores.tolist(), boxes.class_ids.tolist(), strict=True)
    detections = []
    for center, size, score, class_id in columns:
        result = _result(class_names[class_id], score, no_pose)
        pose = new("vision_msgs/msg/Pose2D", new("vision_msgs/msg/Point2D", *center), 0.0)
        box = new("vision_msgs/msg/BoundingBox2D", pose, *size)
        detections.append(new("vision_msgs/msg/Detection2D", header, [result], box, ""))
    return new("vision_msgs/msg/Detection2DArray", header, detections)


def lidcam_objects(objects: Boxes3D, zones: Sequence[Zone], *, stamp_ns: int) -> Any:
    """msgs/MsgLidCam: the objects of the zones `intersection` and `circle`, alpha their yaw.

    Without zones these are y >= 0 and y < 0, as in the predecessor system. A point on the edge of a zone lies in it,
    and the first zone wins: y = 0 is the intersection. Objects of other zones, or of none, are omitted.
    """
    zones = zones or default_zones()
    rows = first_polygon_with([zone.polygon_site for zone in zones], objects.centers[:, :2])
    found: dict[str, list[Any]] = {"intersection": [], "circle": []}
    for row, (x, y, _), yaw in zip(rows.tolist(), objects.centers.tolist(), objects.yaws.tolist(), strict=True):
        if row >= 0 and zones[row].name in found:
            found[zones[row].name].append(ROS2.new("msgs/msg/MsgLidCamObject", x, y, yaw))
    return ROS2.new(
        "msgs/msg/MsgLidCam",
        header=ROS2.header(stamp_ns, objects.frame_id),
        num_intersection=len(found["intersection"]),
        num_circle=len(found["circle"]),
        objects_intersection=found["intersection"],
        objects_circle=found["circle"],
    )


def _result(class_name: str, score: float, pose: Any) -> Any:
    hypothesis = ROS2.new("vision_msgs/msg/ObjectHypothesis", class_name, score)
    return ROS2.new("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis, pose)
