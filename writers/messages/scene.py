"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

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
    details = zip(objects.class_ids.tolist(), objects.scores.tolist(), objects.point_counts.tolist(), strict=True)
    entities = []
    for row, (drawn, (class_id, score, points)) in enumerate(zip(_drawn(result, class_names), details, strict=True)):
        metadata = {
            "class": class_names[class_id],
            "score": f"{score:.4f}",
            "cameras": str(result.fused.matched[row]),
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
                cubes=[
                    _foxglove("CubePrimitive", drawn.pose, ROS2.vector(*drawn.size), _foxglove("Color", *drawn.rgba))
                ],
                spheres=[],
                cylinders=[],
                lines=[],
                triangles=[],
                texts=[_foxglove("TextPrimitive", drawn.label_pose, True, LABEL_PX, True, white, drawn.label)],
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
    for row, (pose, size, rgba, label_pose, label) in enumerate(_drawn(result, class_names)):
        letters = (0.0, 0.0, size[2] * LABEL_SHARE)
        markers.append(_marker(header, "objects", row, _CUBE, pose, size, rgba))
        markers.append(_marker(header, "labels", row, _TEXT_VIEW_FACING, label_pose, letters, white, text=label))
    return ROS2.new("visualization_msgs/msg/MarkerArray", markers)


class _Drawn(NamedTuple):
    pose: Any
    size: list[float]
    rgba: tuple[float, ...]
    label_pose: Any
    label: str


def _drawn(result: FrameResult, class_names: Sequence[str]) -> Iterator[_Drawn]:
    """Each fused object as it is drawn; its label is as far above its roof as a marker's letters need."""
    objects = result.fused.objects
    alphas = np.where(result.fused.matched > 0, ALPHA_CONFIRMED, ALPHA_LIDAR_ONLY).tolist()
    label_places = objects.centers.copy()
    label_places[:, 2] += objects.sizes[:, 2] * (0.5 + LABEL_SHARE)
    return map(
        _Drawn,
        box_poses(objects),
        objects.sizes.tolist(),
        [(*class_color(row), alpha) for row, alpha in zip(objects.class_ids.tolist(), alphas, strict=True)],
        [ROS2.pose(place) for place in label_places.tolist()],
        object_labels(result, class_names),
    )


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
