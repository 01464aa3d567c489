"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D, source_names
from pipeline.core.frame import FrameResult
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.core.ros.messages import ROS2
from writers.drawing import ARROW_SHARE, ground_ellipses, object_colors, object_labels, placed_objects, strong_objects
from writers.messages.parts import (
    box_poses,
    colors,
    ellipses,
    entities,
    labels,
    opaque,
    outlines,
    places_as_poses,
    split,
    vectors,
    whole_scene,
)

__all__ = ["LABEL_SHARE", "label_places", "marker_array", "scene_update"]

LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""


ALPHA_STRONG, ALPHA_PLACED, ALPHA_FAINT = 0.5, 0.15, 0.1
_EDGE_PX = 2.0
_WHITE = (1.0, 1.0, 1.0, 1.0)
_ADD, _DELETE_ALL, _CUBE, _TEXT_VIEW_FACING = 0, 3, 1, 9  # visualization_msgs/Marker
_MARKER, _COLOR = "visualization_msgs/msg/Marker", "std_msgs/msg/ColorRGBA"


def scene_update(result: FrameResult, class_names: Sequence[str]) -> Any:
    """foxglove_msgs/SceneUpdate: a cube and an arrow per fused object, with a label unless it is faint.

    One that the cameras alone place has an ellipse of one standard deviation on the ground.
    """
    objects, n = result.fused.objects, len(result.fused.objects)
    strong, placed = strong_objects(result), placed_objects(result)
    poses, rgba = box_poses(objects), _colors(result)
    edge_colors, thickness_px = opaque(rgba[:, :3]), np.where(strong & ~placed, _EDGE_PX, _EDGE_PX / 2)
    metadata = {
        "class": [class_names[class_id] for class_id in objects.class_ids.tolist()],
        "score": [f"{score:.4f}" for score in objects.scores.tolist()],
        "source": source_names(objects.sources),
        "cameras": list(map(str, result.fused.matched.tolist())),
        "points": list(map(str, objects.point_counts.tolist())),
    }
    length, height = objects.sizes[:, 0], objects.sizes[:, 2]
    arrows = ROS2.rows(
        "foxglove_msgs/msg/ArrowPrimitive",
        n,
        pose=poses,
        shaft_length=0.75 * ARROW_SHARE * length,
        shaft_diameter=0.06 * height,
        head_length=0.25 * ARROW_SHARE * length,
        head_diameter=0.15 * height,
        color=colors(np.where(strong[:, None], edge_colors, rgba)),
    )
    sizes = vectors(objects.sizes)
    cubes = ROS2.rows("foxglove_msgs/msg/CubePrimitive", n, pose=poses, size=sizes, color=colors(rgba))
    edges = outlines(UNIT_CORNERS / 2 * objects.sizes[:, None], edge_colors, thickness_px, poses=poses)
    around = split(ellipses(ground_ellipses(objects)[placed], edge_colors[placed], thickness_px[placed]), placed)
    texts = [text for text, shown in zip(object_labels(result, class_names), strong.tolist(), strict=True) if shown]
    drawn = entities(
        [f"object-{row}" for row in range(n)],
        result.bundle.stamp_ns,
        objects.frame_id,
        metadata,
        arrows=[[arrow] for arrow in arrows],
        cubes=[[cube] for cube in cubes],
        lines=[[edge, *ellipse] for edge, ellipse in zip(edges, around, strict=True)],
        texts=split(labels(texts, label_places(objects)[strong], np.array(_WHITE)), strong),
    )
    return whole_scene(result.bundle.stamp_ns, drawn)


def label_places(boxes: Boxes3D) -> F64:
    """(N, 3) places as far above the roofs of boxes as a marker's letters need."""
    places = boxes.centers.copy()
    places[:, 2] += boxes.sizes[:, 2] * (0.5 + LABEL_SHARE)
    return places


def _colors(result: FrameResult) -> F64:
    """(N, 4) red, green, blue and opacity of each fused object."""
    alpha_strong = np.where(placed_objects(result), ALPHA_PLACED, ALPHA_STRONG)
    alphas = np.where(strong_objects(result), alpha_strong, ALPHA_FAINT)
    return np.concatenate([object_colors(result), alphas[:, None]], 1)


def marker_array(result: FrameResult, class_names: Sequence[str]) -> Any:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer.

    The namespace of a cube names the source of its geometry, `objects/lidar`, `objects/camera` or `objects/both`, so
    that each of them can be hidden; ids are those of the objects.
    """
    objects, n = result.fused.objects, len(result.fused.objects)
    header, white = ROS2.header(result.bundle.stamp_ns, objects.frame_id), ROS2.new(_COLOR, *_WHITE)
    unit, origin = ROS2.vector(1.0, 1.0, 1.0), ROS2.pose((0.0, 0.0, 0.0))
    delete = ROS2.rows(_MARKER, 1, header=header, type=_CUBE, action=_DELETE_ALL, pose=origin, scale=unit, color=white)
    letters = np.zeros((n, 3))
    letters[:, 2] = objects.sizes[:, 2] * LABEL_SHARE
    cubes = ROS2.rows(
        _MARKER,
        n,
        header=header,
        ns=[f"objects/{source}" for source in source_names(objects.sources)],
        id=np.arange(n),
        type=_CUBE,
        action=_ADD,
        pose=box_poses(objects),
        scale=vectors(objects.sizes),
        color=colors(_colors(result), _COLOR),
    )
    texts = ROS2.rows(
        _MARKER,
        n,
        header=header,
        ns="labels",
        id=np.arange(n),
        type=_TEXT_VIEW_FACING,
        action=_ADD,
        pose=places_as_poses(label_places(objects)),
        scale=vectors(letters),
        color=white,
        text=object_labels(result, class_names),
    )
    return ROS2.new("visualization_msgs/msg/MarkerArray", [*delete, *chain(*zip(cubes, texts, strict=True))])
