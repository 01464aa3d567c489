"""Objects as messages for programs: vision_msgs (branch ros2), and MsgLidCam of the predecessor system."""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import join_rows
from pipeline.core.detections import Boxes2D, Boxes3D
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.rig import Zone, default_zones
from pipeline.core.ros.columns import Columns, Lists
from writers.messages.parts import IDENTITY, box_poses, header, headers

__all__ = ["detections_2d", "detections_3d", "lidcam_objects"]

# Rows of a 6 x 6 covariance over x, y, z and the rotations about x, y, z that Boxes3D.covariances has.
_X_Y_YAW = np.array([0, 1, 5])

_RESULT = "vision_msgs/msg/ObjectHypothesisWithPose"


def detections_3d(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Columns:
    """vision_msgs/Detection3DArray: class name, score, pose with the covariance of x, y and yaw, full size.

    `id` is empty: nothing is tracked.
    """
    n = len(boxes)
    covariances = np.zeros((n, 6, 6))
    covariances[:, _X_Y_YAW[:, None], _X_Y_YAW] = boxes.covariances
    poses, array_header = box_poses(boxes), header(stamp_ns, boxes.frame_id)
    with_covariance = Columns(
        "geometry_msgs/msg/PoseWithCovariance", n, pose=poses, covariance=covariances.reshape(n, 36)
    )
    results = _results(boxes, class_names, with_covariance)
    box = Columns("vision_msgs/msg/BoundingBox3D", n, center=poses, size=boxes.sizes)
    detections = Columns("vision_msgs/msg/Detection3D", n, header=array_header, results=Lists(results), bbox=box)
    return Columns("vision_msgs/msg/Detection3DArray", header=array_header, detections=Lists(detections, n))


def detections_2d(
    boxes: Sequence[Boxes2D], class_names: Sequence[str], *, stamps_ns: Sequence[int], frame_ids: Sequence[str]
) -> Columns:
    """vision_msgs/Detection2DArray of each image.

    Of each box class name, score, and centre and size in pixels from the top left corner.
    """
    counts = [len(one) for one in boxes]
    rows = np.repeat(np.arange(len(boxes)), counts).tolist()
    box_headers = headers([stamps_ns[row] for row in rows], [frame_ids[row] for row in rows])
    xyxy = np.concatenate([np.zeros((0, 4)), *(one.xyxy for one in boxes)])
    n, centers = len(xyxy), np.zeros((len(xyxy), 3))
    centers[:, :2], sizes = (xyxy[:, :2] + xyxy[:, 2:]) / 2, xyxy[:, 2:] - xyxy[:, :2]
    no_pose = Columns("geometry_msgs/msg/PoseWithCovariance", pose=IDENTITY)
    results = _results(join_rows(*boxes), class_names, no_pose) if boxes else Columns(_RESULT, 0)
    box = Columns("vision_msgs/msg/BoundingBox2D", n, center=centers, size_x=sizes[:, 0], size_y=sizes[:, 1])
    detections = Columns("vision_msgs/msg/Detection2D", n, header=box_headers, results=Lists(results), bbox=box)
    arrays = headers(stamps_ns, frame_ids)
    return Columns("vision_msgs/msg/Detection2DArray", len(boxes), header=arrays, detections=Lists(detections, counts))


def lidcam_objects(objects: Boxes3D, zones: Sequence[Zone], *, stamp_ns: int) -> Columns:
    """msgs/MsgLidCam: the objects of the zones `intersection` and `circle`, alpha their yaw.

    Without zones these are y >= 0 and y < 0, as in the predecessor system. A point on the edge of a zone lies in it,
    and the first zone wins: y = 0 is the intersection. Objects of other zones, or of none, are omitted.
    """
    zones = zones or default_zones()
    names = [zone.name for zone in zones]
    rows = first_polygon_with([zone.polygon_site for zone in zones], objects.centers[:, :2])
    places = np.column_stack([objects.centers[:, :2], objects.yaws])
    intersection, circle = (
        places[[row >= 0 and names[row] == name for row in rows.tolist()]] for name in ("intersection", "circle")
    )
    return Columns(
        "msgs/msg/MsgLidCam",
        header=header(stamp_ns, objects.frame_id),
        num_intersection=len(intersection),
        num_circle=len(circle),
        objects_intersection=Lists(intersection, len(intersection)),
        objects_circle=Lists(circle, len(circle)),
    )


def _results(boxes: Boxes2D | Boxes3D, class_names: Sequence[str], poses: Columns) -> Columns:
    """The one hypothesis of each box."""
    n, names = len(boxes), [class_names[class_id] for class_id in boxes.class_ids.tolist()]
    hypothesis = Columns("vision_msgs/msg/ObjectHypothesis", n, class_id=names, score=boxes.scores)
    return Columns(_RESULT, n, hypothesis=hypothesis, pose=poses)
