"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.frame import FrameResult
from pipeline.core.ros.messages import ROS2
from writers.messages.detections import box_poses
from writers.palette import class_color

__all__ = ["marker_array", "object_labels", "scene_update"]

LABEL_PX = 13.0
LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""

ALPHA_CONFIRMED, ALPHA_LIDAR_ONLY = 0.6, 0.3
_DELETE_ALL_ENTITIES = 1  # SceneEntityDeletion.ALL
_ADD, _DELETE_ALL, _CUBE, _TEXT_VIEW_FACING = 0, 3, 1, 9  # visualization_msgs/Marker


def object_labels(result: FrameResult, class_names: Sequence[str]) -> list[str]:
    """The text beside each fused object: class, score, and how many cameras confirm it."""
    objects = result.fused.objects
    columns = zip(objects.class_ids.tolist(), objects.scores.tolist(), result.fused.matched.tolist(), strict=True)
    return [
        f"{class_names[class_id]} {score:.2f}" + (f" ({cameras} cam)" if cameras else "")
        for class_id, score, cameras in columns
    ]


def scene_update(result: FrameResult, class_names: Sequence[str]) -> Any:
    """foxglove_msgs/SceneUpdate: a cube and a label per fused object; those that a camera confirms are more opaque."""
    objects, stamp = result.fused.objects, ROS2.time(result.bundle.stamp_ns)
    white = _foxglove("Color", 1.0, 1.0, 1.0, 1.0)
    columns = zip(
        box_poses(objects),
        objects.sizes.tolist(),
        _label_poses(result),
        object_labels(result, class_names),
        objects.class_ids.tolist(),
        objects.scores.tolist(),
        objects.point_counts.tolist(),
        result.fused.matched.tolist(),
        strict=True,
    )
    entities = []
    for row, (pose, size, label_pose, label, class_id, score, points, cameras) in enumerate(columns):
        color = _foxglove("Color", *class_color(class_id), ALPHA_CONFIRMED if cameras else ALPHA_LIDAR_ONLY)
        metadata = {
            "class": class_names[class_id],
            "score": f"{score:.4f}",
            "cameras": str(cameras),
            "points": str(points),
        }
        entities.append(
            _foxglove(
                "SceneEntity",
                timestamp=stamp,
                frame_id=objects.frame_id,
                id=f"object-{row}",
                lifetime=_forever(),
                frame_locked=False,
                metadata=[_foxglove("KeyValuePair", key, value) for key, value in metadata.items()],
                arrows=[],
                cubes=[_foxglove("CubePrimitive", pose, ROS2.vector(*size), color)],
                spheres=[],
                cylinders=[],
                lines=[],
                triangles=[],
                texts=[_foxglove("TextPrimitive", label_pose, True, LABEL_PX, True, white, label)],
                models=[],
            )
        )
    return _foxglove("SceneUpdate", [_foxglove("SceneEntityDeletion", stamp, _DELETE_ALL_ENTITIES, "")], entities)


def marker_array(result: FrameResult, class_names: Sequence[str]) -> Any:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer."""
    objects = result.fused.objects
    header = ROS2.header(result.bundle.stamp_ns, objects.frame_id)
    white = (1.0, 1.0, 1.0, 1.0)
    origin, unit_size = ROS2.pose((0.0, 0.0, 0.0)), (1.0, 1.0, 1.0)
    markers = [_marker(header, "", 0, _CUBE, origin, unit_size, white, action=_DELETE_ALL)]
    columns = zip(
        box_poses(objects),
        objects.sizes.tolist(),
        _label_poses(result),
        object_labels(result, class_names),
        objects.class_ids.tolist(),
        result.fused.matched.tolist(),
        strict=True,
    )
    for row, (pose, size, label_pose, label, class_id, cameras) in enumerate(columns):
        color = (*class_color(class_id), ALPHA_CONFIRMED if cameras else ALPHA_LIDAR_ONLY)
        letters = (0.0, 0.0, size[2] * LABEL_SHARE)
        markers.append(_marker(header, "objects", row, _CUBE, pose, size, color))
        markers.append(_marker(header, "labels", row, _TEXT_VIEW_FACING, label_pose, letters, white, text=label))
    return ROS2.new("visualization_msgs/msg/MarkerArray", markers)


def _label_poses(result: FrameResult) -> list[Any]:
    """A place above each object, as far from its roof as a marker's letters need."""
    places = result.fused.objects.centers.copy()
    places[:, 2] += result.fused.objects.sizes[:, 2] * (0.5 + LABEL_SHARE)
    return [ROS2.pose(place) for place in places.tolist()]


def _foxglove(name: str, *values: Any, **fields: Any) -> Any:
    return ROS2.new(f"foxglove_msgs/msg/{name}", *values, **fields)


def _forever() -> Any:
    return ROS2.new("builtin_interfaces/msg/Duration", 0, 0)


def _marker(
    header: Any,
    namespace: str,
    row: int,
    kind: int,
    pose: Any,
    scale: Sequence[float],
    color: Sequence[float],
    *,
    action: int = _ADD,
    text: str = "",
) -> Any:
    no_bytes = np.zeros(0, np.uint8)
    return ROS2.new(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=namespace,
        id=row,
        type=kind,
        action=action,
        pose=pose,
        scale=ROS2.vector(*scale),
        color=ROS2.new("std_msgs/msg/ColorRGBA", *color),
        lifetime=_forever(),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=ROS2.compressed_image(0, "", "", no_bytes),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=ROS2.new("visualization_msgs/msg/MeshFile", "", no_bytes),
        mesh_use_embedded_materials=False,
    )
