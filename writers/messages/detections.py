"""Objects as messages for programs: vision_msgs (branch ros2), lidcam's tracks, MsgLidCam of the predecessor system."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, source_names
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.rig import Zone, default_zones
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.tracks import NO_TRACK, Tracks
from lidcam.writers.messages.parts import box_poses, vectors

# Rows of a 6 x 6 covariance over x, y, z and the rotations about x, y, z that a covariance over x, y, yaw has.
_X_Y_YAW = np.array([0, 1, 5])


def detections_3d(
    boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int, track_numbers: I64 | None = None
) -> Any:
    """vision_msgs/Detection3DArray: class name, score, pose with the covariance of x, y and yaw, full size.

    `id` is the number of the track (N,) of each box, empty where it is `NO_TRACK`; None: nothing is tracked.
    """
    n = len(boxes)
    poses, header = box_poses(boxes), ROS2.header(stamp_ns, boxes.frame_id)
    box = ROS2.rows("vision_msgs/msg/BoundingBox3D", n, center=poses, size=vectors(boxes.sizes))
    results = _results(boxes, class_names, _with_covariance(boxes, poses))
    numbers = [NO_TRACK] * n if track_numbers is None else track_numbers.tolist()
    ids = [str(number) if number != NO_TRACK else "" for number in numbers]
    detections = ROS2.rows("vision_msgs/msg/Detection3D", n, header=header, results=results, bbox=box, id=ids)
    return ROS2.new("vision_msgs/msg/Detection3DArray", header, detections)


def track_array(boxes: Boxes3D, tracks: Tracks, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """lidcam_msgs/TrackArray of objects and their tracks, without those that belong to none."""
    rows = np.flatnonzero(tracks.ids != NO_TRACK)
    boxes, tracks, n = boxes.select(rows), tracks.select(rows), len(rows)
    spins = np.zeros((n, 3))
    spins[:, 2] = tracks.yaw_rates
    twists = ROS2.rows(
        "geometry_msgs/msg/Twist", n, linear=vectors(np.c_[tracks.velocities, np.zeros(n)]), angular=vectors(spins)
    )
    covariances = np.zeros((n, 3, 3))
    covariances[:, :2, :2], covariances[:, 2, 2] = tracks.velocity_covariances, tracks.yaw_rate_variances
    ages_ns = np.round(tracks.ages_s * 1e9).astype(np.int64)
    found = ROS2.rows(
        "lidcam_msgs/msg/Track",
        n,
        id=tracks.ids,
        class_id=[class_names[class_id] for class_id in boxes.class_ids.tolist()],
        existence=tracks.existence,
        age=[ROS2.new("builtin_interfaces/msg/Duration", *divmod(age_ns, 10**9)) for age_ns in ages_ns.tolist()],
        source=source_names(boxes.sources),
        front_known=tracks.fronts_known,
        pose=_with_covariance(boxes, box_poses(boxes)),
        twist=ROS2.rows("geometry_msgs/msg/TwistWithCovariance", n, twist=twists, covariance=_six_by_six(covariances)),
        size=vectors(boxes.sizes),
    )
    return ROS2.new("lidcam_msgs/msg/TrackArray", ROS2.header(stamp_ns, boxes.frame_id), found)


def _with_covariance(boxes: Boxes3D, poses: list[Any]) -> list[Any]:
    """geometry_msgs/PoseWithCovariance of each box."""
    covariances = _six_by_six(boxes.covariances)
    return ROS2.rows("geometry_msgs/msg/PoseWithCovariance", len(boxes), pose=poses, covariance=covariances)


def _six_by_six(x_y_yaw: F64) -> F64:
    """(N, 36) covariances as ROS has them, of those over x, y, yaw (N, 3, 3)."""
    full = np.zeros((len(x_y_yaw), 6, 6))
    full[:, _X_Y_YAW[:, None], _X_Y_YAW] = x_y_yaw
    return full.reshape(-1, 36)


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
