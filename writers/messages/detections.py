"""Objects as messages for programs: vision_msgs (branch ros2), and MsgLidCam of the predecessor system."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone, default_zones
from pipeline.core.ros.messages import ROS2
from writers.messages.parts import box_poses, vectors

__all__ = ["detections_2d", "detections_3d", "lidcam_objects"]

# Rows of a 6 x 6 covariance over x, y, z and the rotations about x, y, z that Boxes3D.covariances has.
_X_Y_YAW = np.array([0, 1, 5])


def detections_3d(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """vision_msgs/Detection3DArray: class name, score, pose with the covariance of x, y and yaw, full size.

    `id` is empty: nothing is tracked.
    """
    n = len(boxes)
    covariances = np.zeros((n, 6, 6))
    covariances[:, _X_Y_YAW[:, None], _X_Y_YAW] = boxes.covariances
    poses, header = box_poses(boxes), ROS2.header(stamp_ns, boxes.frame_id)
    with_covariance = ROS2.rows(
        "geometry_msgs/msg/PoseWithCovariance", n, pose=poses, covariance=covariances.reshape(n, 36)
    )
    box = ROS2.rows("vision_msgs/msg/BoundingBox3D", n, center=poses, size=vectors(boxes.sizes))
    results = _results(boxes, class_names, with_covariance)
    detections = ROS2.rows("vision_msgs/msg/Detection3D", n, header=header, results=results, bbox=box)
    return ROS2.new("vision_msgs/msg/Detection3DArray", header, detections)


def detections_2d(boxes: Boxes2D, class_names: Sequence[str], *, stamp_ns: int, frame_id: str) -> Any:
    """vision_msgs/Detection2DArray of an image.

    Of each box class name, score, and centre and size in pixels from the top left corner.
    """
    n, header = len(boxes), ROS2.header(stamp_ns, frame_id)
    low, high = boxes.xyxy[:, :2].astype(np.float64), boxes.xyxy[:, 2:].astype(np.float64)
    centers = ROS2.rows_of_numbers("vision_msgs/msg/Point2D", (low + high) / 2)
    poses = ROS2.rows("vision_msgs/msg/Pose2D", n, position=centers)
    sizes = high - low
    box = ROS2.rows("vision_msgs/msg/BoundingBox2D", n, center=poses, size_x=sizes[:, 0], size_y=sizes[:, 1])
    results = _results(boxes, class_names, ROS2.pose_with_covariance(ROS2.pose((0.0, 0.0, 0.0))))
    detections = ROS2.rows("vision_msgs/msg/Detection2D", n, header=header, results=results, bbox=box)
    return ROS2.new("vision_msgs/msg/Detection2DArray", header, detections)


def lidcam_objects(objects: Boxes3D, zones: Sequence[Zone], *, stamp_ns: int) -> Any:
    """msgs/MsgLidCam: the objects of the zones `intersection` and `circle`, alpha their yaw.

    Without zones these are y >= 0 and y < 0, as in the predecessor system. A point on the edge of a zone lies in it,
    and the first zone wins: y = 0 is the intersection. Objects of other zones, or of none, are omitted.
    """
    zones = zones or default_zones()
    names = [zone.name for zone in zones]
    rows = first_polygon_with([zone.polygon_site for zone in zones], objects.centers[:, :2])
    places = np.column_stack([objects.centers[:, :2], objects.yaws])
    intersection, circle = (
        ROS2.rows_of_numbers(
            "msgs/msg/MsgLidCamObject", places[[row >= 0 and names[row] == name for row in rows.tolist()]]
        )
        for name in ("intersection", "circle")
    )
    header = ROS2.header(stamp_ns, objects.frame_id)
    return ROS2.new("msgs/msg/MsgLidCam", header, len(intersection), len(circle), intersection, circle)


def _results(boxes: Boxes2D | Boxes3D, class_names: Sequence[str], poses: Any) -> list[list[Any]]:
    """The one hypothesis of each box."""
    n, names = len(boxes), [class_names[class_id] for class_id in boxes.class_ids.tolist()]
    hypotheses = ROS2.rows("vision_msgs/msg/ObjectHypothesis", n, class_id=names, score=boxes.scores)
    results = ROS2.rows("vision_msgs/msg/ObjectHypothesisWithPose", n, hypothesis=hypotheses, pose=poses)
    return [[result] for result in results]
