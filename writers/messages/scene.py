"""Objects as things to look at in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, whatever the gap between frames.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys.stores.ros2_humble import builtin_interfaces__msg__Duration as Duration
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Point as Point
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Quaternion as Quaternion
from rosbags.typesys.stores.ros2_humble import geometry_msgs__msg__Vector3 as Vector3
from rosbags.typesys.stores.ros2_humble import sensor_msgs__msg__CompressedImage as CompressedImage
from rosbags.typesys.stores.ros2_humble import std_msgs__msg__ColorRGBA as ColorRGBA
from rosbags.typesys.stores.ros2_humble import std_msgs__msg__Header as Header
from rosbags.typesys.stores.ros2_humble import visualization_msgs__msg__Marker as Marker
from rosbags.typesys.stores.ros2_humble import visualization_msgs__msg__MarkerArray as MarkerArray
from rosbags.typesys.stores.ros2_humble import visualization_msgs__msg__MeshFile as MeshFile

from pipeline.core.frame import FrameResult
from writers.messages.definitions import message_type
from writers.messages.ros_messages import box_poses, header, time, vectors
from writers.palette import class_color

__all__ = ["marker_array", "object_labels", "scene_update"]

LABEL_PX = 13.0
LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""

ALPHA_CONFIRMED, ALPHA_LIDAR_ONLY = 0.6, 0.3
_FOREVER = Duration(0, 0)
_UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)


def object_labels(result: FrameResult, class_names: Sequence[str]) -> list[str]:
    """What is written beside each fused object: class, score, and how many cameras confirm it."""
    objects = result.fused.objects
    columns = zip(objects.class_ids.tolist(), objects.scores.tolist(), result.fused.matched.tolist(), strict=True)
    return [
        f"{class_names[class_id]} {score:.2f}" + (f" ({cameras} cam)" if cameras else "")
        for class_id, score, cameras in columns
    ]


class _Types(NamedTuple):
    color: Any
    pair: Any
    cube: Any
    text: Any
    deletion: Any
    entity: Any
    update: Any


@cache
def _types() -> _Types:
    names = ("Color", "KeyValuePair", "CubePrimitive", "TextPrimitive", "SceneEntityDeletion", "SceneEntity")
    return _Types(*(message_type(f"foxglove_msgs/msg/{name}") for name in (*names, "SceneUpdate")))


def scene_update(result: FrameResult, class_names: Sequence[str]) -> Any:
    """foxglove_msgs/SceneUpdate: a cube and a label for each fused object; those that a camera confirms are denser."""
    types, objects, stamp = _types(), result.fused.objects, time(result.bundle.stamp_ns)
    white = types.color(1.0, 1.0, 1.0, 1.0)
    columns = zip(
        box_poses(objects),
        vectors(objects.sizes.tolist()),
        _label_points(result),
        object_labels(result, class_names),
        objects.class_ids.tolist(),
        objects.scores.tolist(),
        objects.point_counts.tolist(),
        result.fused.matched.tolist(),
        strict=True,
    )
    entities = []
    for row, (pose, size, label_at, label, class_id, score, points, cameras) in enumerate(columns):
        alpha = ALPHA_CONFIRMED if cameras else ALPHA_LIDAR_ONLY
        metadata = {
            "class": class_names[class_id],
            "score": f"{score:.4f}",
            "cameras": str(cameras),
            "points": str(points),
        }
        entities.append(
            types.entity(
                timestamp=stamp,
                frame_id=objects.frame_id,
                id=f"object-{row}",
                lifetime=_FOREVER,
                frame_locked=False,
                metadata=[types.pair(key, value) for key, value in metadata.items()],
                arrows=[],
                cubes=[types.cube(pose, size, types.color(*class_color(class_id), alpha))],
                spheres=[],
                cylinders=[],
                lines=[],
                triangles=[],
                texts=[types.text(Pose(label_at, _UPRIGHT), True, LABEL_PX, True, white, label)],
                models=[],
            )
        )
    return types.update([types.deletion(stamp, types.deletion.ALL, "")], entities)


def marker_array(result: FrameResult, class_names: Sequence[str]) -> MarkerArray:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer."""
    objects = result.fused.objects
    top = header(result.bundle.stamp_ns, objects.frame_id)
    white, nowhere, nothing = (
        ColorRGBA(1.0, 1.0, 1.0, 1.0),
        Pose(Point(0.0, 0.0, 0.0), _UPRIGHT),
        Vector3(1.0, 1.0, 1.0),
    )
    clear = _marker(top, "", 0, Marker.CUBE, nowhere, nothing, white, action=Marker.DELETEALL)
    columns = zip(
        box_poses(objects),
        vectors(objects.sizes.tolist()),
        _label_points(result),
        object_labels(result, class_names),
        objects.class_ids.tolist(),
        result.fused.matched.tolist(),
        strict=True,
    )
    markers = [clear]
    for row, (pose, size, label_at, label, class_id, cameras) in enumerate(columns):
        color = ColorRGBA(*class_color(class_id), ALPHA_CONFIRMED if cameras else ALPHA_LIDAR_ONLY)
        letters = Vector3(0.0, 0.0, size.z * LABEL_SHARE)
        at = Pose(label_at, _UPRIGHT)
        markers.append(_marker(top, "objects", row, Marker.CUBE, pose, size, color))
        markers.append(_marker(top, "labels", row, Marker.TEXT_VIEW_FACING, at, letters, white, text=label))
    return MarkerArray(markers)  # type: ignore[arg-type]  # rosbags names the same type of another release there


def _label_points(result: FrameResult) -> list[Point]:
    """A place above each object, away from its roof by as much as a marker's letters need."""
    at = result.fused.objects.centers.copy()
    at[:, 2] += result.fused.objects.sizes[:, 2] * (0.5 + LABEL_SHARE)
    return [Point(x, y, z) for x, y, z in at.tolist()]


_NO_IMAGE = CompressedImage(header(0, ""), "", np.zeros(0, np.uint8))
_NO_MESH = MeshFile("", np.zeros(0, np.uint8))


def _marker(
    top: Header,
    namespace: str,
    row: int,
    kind: int,
    pose: Pose,
    scale: Vector3,
    color: ColorRGBA,
    *,
    action: int = Marker.ADD,
    text: str = "",
) -> Marker:
    return Marker(
        header=top,
        ns=namespace,
        id=row,
        type=kind,
        action=action,
        pose=pose,
        scale=scale,
        color=color,
        lifetime=_FOREVER,
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=_NO_IMAGE,
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=_NO_MESH,
        mesh_use_embedded_materials=False,
    )
