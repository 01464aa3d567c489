"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import source_names
from pipeline.core.frame import FrameResult
from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.core.ros.messages import ROS2
from writers.drawing import ARROW_SHARE, object_colors, object_labels, placed_objects, strong_objects
from writers.messages.detections import box_poses
from writers.uncertainty import ground_ellipses

__all__ = ["LABEL_SHARE", "ellipse", "label", "marker_array", "outline", "scene_entity", "scene_update", "whole_scene"]

LABEL_PX = 13.0
LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""


ALPHA_STRONG, ALPHA_PLACED, ALPHA_FAINT = 0.5, 0.15, 0.1
_EDGE_PX = 2.0
_WHITE = (1.0, 1.0, 1.0)
_NO_INDICES = np.zeros(0, np.uint32)
_EDGES = BOX_EDGES.reshape(-1).astype(np.uint32)
_LINE_LOOP, _LINE_LIST = 1, 2  # LinePrimitive
_DELETE_ALL_ENTITIES = 1  # SceneEntityDeletion.ALL
_ADD, _DELETE_ALL, _CUBE, _TEXT_VIEW_FACING = 0, 3, 1, 9  # visualization_msgs/Marker


def scene_update(result: FrameResult, class_names: Sequence[str]) -> Any:
    """foxglove_msgs/SceneUpdate: a cube and an arrow per fused object, with a label unless it is faint.

    One that the cameras alone place has an ellipse of one standard deviation on the ground.
    """
    objects, stamp = result.fused.objects, ROS2.time(result.bundle.stamp_ns)
    strong, placed, ellipses = (
        strong_objects(result).tolist(),
        placed_objects(result).tolist(),
        ground_ellipses(objects),
    )
    details = zip(
        objects.class_ids.tolist(),
        objects.scores.tolist(),
        objects.point_counts.tolist(),
        source_names(objects.sources),
        strict=True,
    )
    entities = []
    for row, (drawn, (class_id, score, points, source)) in enumerate(
        zip(_drawn(result, class_names), details, strict=True)
    ):
        text = label(drawn.label, drawn.label_pose, _WHITE)
        thickness_px = _EDGE_PX if strong[row] and not placed[row] else _EDGE_PX / 2
        lines = [outline(drawn.pose, drawn.size, drawn.rgba[:3], thickness_px)]
        if placed[row]:
            lines.append(ellipse(ellipses[row], drawn.rgba[:3], thickness_px))
        metadata = {
            "class": class_names[class_id],
            "score": f"{score:.4f}",
            "source": source,
            "cameras": str(result.fused.matched[row]),
            "points": str(points),
        }
        cube = _foxglove("CubePrimitive", drawn.pose, ROS2.vector(*drawn.size), _foxglove("Color", *drawn.rgba))
        entities.append(
            scene_entity(
                f"object-{row}",
                stamp,
                objects.frame_id,
                metadata,
                arrows=[_arrow(drawn, opaque=strong[row])],
                cubes=[cube],
                lines=lines,
                texts=[text] if strong[row] else [],
            )
        )
    return whole_scene(stamp, entities)


def scene_entity(
    entity_id: str, stamp: Any, frame_id: str, metadata: Mapping[str, str], **primitives: Sequence[Any]
) -> Any:
    """foxglove_msgs/SceneEntity that stays until it is deleted; `primitives` by name, `cubes=[...]`."""
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return _foxglove(
        "SceneEntity",
        timestamp=stamp,
        frame_id=frame_id,
        id=entity_id,
        lifetime=_forever(),
        frame_locked=False,
        metadata=[_foxglove("KeyValuePair", key, value) for key, value in metadata.items()],
        **{kind: list(primitives.get(kind, ())) for kind in kinds},
    )


def whole_scene(stamp: Any, entities: Sequence[Any]) -> Any:
    """foxglove_msgs/SceneUpdate that leaves nothing of the scene before it."""
    deletion = _foxglove("SceneEntityDeletion", stamp, _DELETE_ALL_ENTITIES, "")
    return _foxglove("SceneUpdate", [deletion], list(entities))


def marker_array(result: FrameResult, class_names: Sequence[str]) -> Any:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer.

    The namespace of a cube tells what its geometry comes from, `objects/lidar`, `objects/camera` or `objects/both`, so
    that each of them can be hidden; ids are those of the objects.
    """
    objects = result.fused.objects
    sources = source_names(objects.sources)
    header = ROS2.header(result.bundle.stamp_ns, objects.frame_id)
    white = (1.0, 1.0, 1.0, 1.0)
    origin, unit_size = ROS2.pose((0.0, 0.0, 0.0)), (1.0, 1.0, 1.0)
    markers = [_marker(header, "", 0, _CUBE, origin, unit_size, white, action=_DELETE_ALL)]
    for row, (pose, size, rgba, label_pose, label) in enumerate(_drawn(result, class_names)):
        letters = (0.0, 0.0, size[2] * LABEL_SHARE)
        markers.append(_marker(header, f"objects/{sources[row]}", row, _CUBE, pose, size, rgba))
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
    alpha_strong = np.where(placed_objects(result), ALPHA_PLACED, ALPHA_STRONG)
    alphas = np.where(strong_objects(result), alpha_strong, ALPHA_FAINT).tolist()
    label_places = objects.centers.copy()
    label_places[:, 2] += objects.sizes[:, 2] * (0.5 + LABEL_SHARE)
    return map(
        _Drawn,
        box_poses(objects),
        objects.sizes.tolist(),
        [(*color, alpha) for color, alpha in zip(object_colors(result).tolist(), alphas, strict=True)],
        [ROS2.pose(place) for place in label_places.tolist()],
        object_labels(result, class_names),
    )


def _arrow(drawn: _Drawn, *, opaque: bool) -> Any:
    """An arrow from the centre of an object through its front."""
    length, _, height = drawn.size
    shaft, head = 0.75 * ARROW_SHARE * length, 0.25 * ARROW_SHARE * length
    color = _foxglove("Color", *drawn.rgba[:3], 1.0 if opaque else drawn.rgba[3])
    return _foxglove("ArrowPrimitive", drawn.pose, shaft, 0.06 * height, head, 0.15 * height, color)


def outline(pose: Any, size: Sequence[float], rgb: Sequence[float], thickness_px: float) -> Any:
    """foxglove_msgs/LinePrimitive: the edges of a box."""
    corners, color = UNIT_CORNERS / 2 * size, _foxglove("Color", *rgb, 1.0)
    return _foxglove("LinePrimitive", _LINE_LIST, pose, thickness_px, True, corners, color, [], _EDGES)


def ellipse(points: F64, rgb: Sequence[float], thickness_px: float) -> Any:
    """foxglove_msgs/LinePrimitive: a closed line through points (N, 3) of the scene."""
    pose, color = ROS2.pose((0.0, 0.0, 0.0)), _foxglove("Color", *rgb, 1.0)
    return _foxglove("LinePrimitive", _LINE_LOOP, pose, thickness_px, True, points, color, [], _NO_INDICES)


def label(text: str, pose: Any, rgb: Sequence[float]) -> Any:
    """foxglove_msgs/TextPrimitive that faces the viewer."""
    return _foxglove("TextPrimitive", pose, True, LABEL_PX, True, _foxglove("Color", *rgb, 1.0), text)


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
