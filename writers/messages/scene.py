"""Objects drawn in 3D: Foxglove's SceneUpdate and RViz's MarkerArray.

Each message first deletes what the one before it drew, so nothing stale stays, however long the gap between frames.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.detections import Boxes3D, source_names
from pipeline.core.frame import FrameResult
from pipeline.core.geometry.boxes import UNIT_CORNERS
from pipeline.core.ros.columns import Columns, Lists
from writers.drawing import ARROW_SHARE, object_colors, object_labels, placed_objects, strong_objects
from writers.messages.parts import IDENTITY, box_poses, header, places_as_poses
from writers.messages.scene_parts import ellipses, entities, labels, opaque, outlines, whole_scene
from writers.uncertainty import ground_ellipses

__all__ = ["LABEL_SHARE", "label_places", "marker_array", "scene_update"]

LABEL_SHARE = 0.35
"""Height of a marker's letters as a share of the height of its box: fits a street and a 1:14 model of one."""


ALPHA_STRONG, ALPHA_PLACED, ALPHA_FAINT = 0.5, 0.15, 0.1
_EDGE_PX = 2.0
_WHITE = (1.0, 1.0, 1.0, 1.0)
_ADD, _DELETE_ALL, _CUBE, _TEXT_VIEW_FACING = 0, 3, 1, 9  # visualization_msgs/Marker
_MARKER = "visualization_msgs/msg/Marker"


def scene_update(result: FrameResult, class_names: Sequence[str]) -> Columns:
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
    arrows = Columns(
        "foxglove_msgs/msg/ArrowPrimitive",
        n,
        pose=poses,
        shaft_length=0.75 * ARROW_SHARE * length,
        shaft_diameter=0.06 * height,
        head_length=0.25 * ARROW_SHARE * length,
        head_diameter=0.15 * height,
        color=np.where(strong[:, None], edge_colors, rgba),
    )
    edges = outlines(UNIT_CORNERS / 2 * objects.sizes[:, None], edge_colors, thickness_px, poses=poses)
    around = ellipses(ground_ellipses(objects)[placed], edge_colors[placed], thickness_px[placed])
    texts = [text for text, shown in zip(object_labels(result, class_names), strong.tolist(), strict=True) if shown]
    drawn = entities(
        [f"object-{row}" for row in range(n)],
        result.bundle.stamp_ns,
        objects.frame_id,
        metadata,
        arrows=Lists(arrows),
        cubes=Lists(Columns("foxglove_msgs/msg/CubePrimitive", n, pose=poses, size=objects.sizes, color=rgba)),
        lines=Lists(edges, 1, Lists(around, placed.astype(np.int64))),
        texts=Lists(labels(texts, label_places(objects)[strong], _WHITE), strong.astype(np.int64)),
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


def marker_array(result: FrameResult, class_names: Sequence[str]) -> Columns:
    """visualization_msgs/MarkerArray: DELETEALL, then for each fused object a cube and a label facing the viewer.

    The namespace of a cube tells what its geometry comes from, `objects/lidar`, `objects/camera` or `objects/both`, so
    that each of them can be hidden; ids are those of the objects.
    """
    objects, n = result.fused.objects, len(result.fused.objects)
    same_header = header(result.bundle.stamp_ns, objects.frame_id)
    unit = (1.0, 1.0, 1.0)
    delete = Columns(
        _MARKER, header=same_header, type=_CUBE, action=_DELETE_ALL, pose=IDENTITY, scale=unit, color=_WHITE
    )
    letters = np.zeros((n, 3))
    letters[:, 2] = objects.sizes[:, 2] * LABEL_SHARE
    markers = Columns(
        _MARKER,
        2 * n,
        header=same_header,
        ns=[name for source in source_names(objects.sources) for name in (f"objects/{source}", "labels")],
        id=np.repeat(np.arange(n), 2),
        type=np.tile(np.array([_CUBE, _TEXT_VIEW_FACING]), n),
        action=_ADD,
        pose=_in_turn(box_poses(objects), places_as_poses(label_places(objects))),
        scale=_in_turn(objects.sizes, letters),
        color=_in_turn(_colors(result), np.tile(np.array(_WHITE), (n, 1))),
        text=[text for label in object_labels(result, class_names) for text in ("", label)],
    )
    return Columns("visualization_msgs/msg/MarkerArray", markers=Lists(delete, 1, Lists(markers, 2 * n)))


def _in_turn(first: F64, second: F64) -> F64:
    """(2 N, K) rows of (N, K) and of (N, K) in turn."""
    return np.stack([first, second], 1).reshape(-1, first.shape[1])
