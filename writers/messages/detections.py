"""Objects as messages for programs: vision_msgs (branch ros2), and the original system's MsgLidCam."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Quaternion as Quaternion

from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone
from writers.messages.definitions import message_type
from writers.messages.ros_messages import box_poses, header, vectors

__all__ = ["detections_2d", "detections_3d", "lidcam_objects"]

# Rows of a 6 x 6 covariance over x, y, z and the rotations about x, y, z that Boxes3D.covariances has.
_X_Y_YAW = np.array([0, 1, 5])


class _Types(NamedTuple):
    hypothesis: Any
    result: Any
    box_3d: Any
    detection_3d: Any
    detections_3d: Any
    point_2d: Any
    pose_2d: Any
    box_2d: Any
    detection_2d: Any
    detections_2d: Any


@cache
def _types() -> _Types:
    shared = ("ObjectHypothesis", "ObjectHypothesisWithPose")
    in_3d = ("BoundingBox3D", "Detection3D", "Detection3DArray")
    in_2d = ("Point2D", "Pose2D", "BoundingBox2D", "Detection2D", "Detection2DArray")
    return _Types(*(message_type(f"vision_msgs/msg/{name}") for name in (*shared, *in_3d, *in_2d)))


def detections_3d(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """vision_msgs/Detection3DArray: class name, score, pose with the covariance of x, y and yaw, full size.

    `id` is empty: nothing is tracked.
    """
    types, top = _types(), header(stamp_ns, boxes.frame_id)
    covariances = np.zeros((len(boxes), 6, 6))
    covariances[:, _X_Y_YAW[:, None], _X_Y_YAW] = boxes.covariances
    columns = zip(
        box_poses(boxes),
        vectors(boxes.sizes.tolist()),
        boxes.scores.tolist(),
        boxes.class_ids.tolist(),
        covariances.reshape(-1, 36),
        strict=True,
    )
    detections = []
    for pose, size, score, class_id, covariance in columns:
        result = types.result(types.hypothesis(class_names[class_id], score), PoseWithCovariance(pose, covariance))
        detections.append(types.detection_3d(top, [result], types.box_3d(pose, size), ""))
    return types.detections_3d(top, detections)


def detections_2d(boxes: Boxes2D, class_names: Sequence[str], *, stamp_ns: int, frame_id: str) -> Any:
    """vision_msgs/Detection2DArray: class name, score, centre and size in pixels from the top left corner."""
    types, top = _types(), header(stamp_ns, frame_id)
    nowhere = PoseWithCovariance(Pose(Point(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)), np.zeros(36))
    xyxy = boxes.xyxy.astype(np.float64)
    centers, sizes = (xyxy[:, :2] + xyxy[:, 2:]) / 2, xyxy[:, 2:] - xyxy[:, :2]
    columns = zip(centers.tolist(), sizes.tolist(), boxes.scores.tolist(), boxes.class_ids.tolist(), strict=True)
    detections = []
    for (x, y), (width, height), score, class_id in columns:
        result = types.result(types.hypothesis(class_names[class_id], score), nowhere)
        box = types.box_2d(types.pose_2d(types.point_2d(x, y), 0.0), width, height)
        detections.append(types.detection_2d(top, [result], box, ""))
    return types.detections_2d(top, detections)


def lidcam_objects(objects: Boxes3D, zones: Sequence[Zone], *, stamp_ns: int) -> Any:
    """msgs/MsgLidCam: the objects of the zones `intersection` and `circle`, alpha their yaw.

    A point on the edge of a zone is in it and the first zone wins: with the default zones y = 0 is the intersection.
    Objects of other zones, or of none, are left out.
    """
    of_zone = message_type("msgs/msg/MsgLidCamObject")
    rows = first_polygon_with([zone.polygon_site for zone in zones], objects.centers[:, :2])
    found: dict[str, list[Any]] = {"intersection": [], "circle": []}
    for row, (x, y, _), yaw in zip(rows.tolist(), objects.centers.tolist(), objects.yaws.tolist(), strict=True):
        if row >= 0 and zones[row].name in found:
            found[zones[row].name].append(of_zone(x, y, yaw))
    return message_type("msgs/msg/MsgLidCam")(
        header=header(stamp_ns, objects.frame_id),
        num_intersection=len(found["intersection"]),
        num_circle=len(found["circle"]),
        objects_intersection=found["intersection"],
        objects_circle=found["circle"],
    )
