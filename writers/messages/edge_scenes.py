"""Boxes drawn in 3D by their edges, beside the objects: Foxglove draws no vision_msgs."""

from collections.abc import Sequence
from typing import Any

from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.geometry.boxes import UNIT_CORNERS, box_corners
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.drawing import ground_ellipses
from lidcam.writers.messages.parts import box_poses, ellipses, entities, labels, opaque, outlines, whole_scene
from lidcam.writers.palette import CAMERA_ONLY, TRUTH

PLACED = "/cameras/detections"
PLACED_SCENE = "/cameras/scene"
"""Topics of the boxes that the cameras alone place; they have a message where a camera has 2D boxes."""

PLACED_EDGE_PX, TRUTH_EDGE_PX = 1.0, 1.5
LABEL_SHARE = 0.6
"""Height of a label above the centre, as a share of the height of the box: just above its roof."""


def truth_scene_topic(topic: str) -> str:
    """Topic on which the objects of a topic of truth are drawn."""
    return f"{topic}/scene"


def placed_scene(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """foxglove_msgs/SceneUpdate: edges, class and score of each box, and an ellipse of one standard deviation."""
    names, scores = [class_names[class_id] for class_id in boxes.class_ids.tolist()], boxes.scores.tolist()
    color = opaque(CAMERA_ONLY)
    edges = outlines(UNIT_CORNERS / 2 * boxes.sizes[:, None], color, PLACED_EDGE_PX, poses=box_poses(boxes))
    around = ellipses(ground_ellipses(boxes), color, PLACED_EDGE_PX)
    texts = [f"{name} {score:.2f}" for name, score in zip(names, scores, strict=True)]
    drawn = entities(
        [f"placed-{row}" for row in range(len(boxes))],
        stamp_ns,
        boxes.frame_id,
        {"class": names, "score": [f"{score:.4f}" for score in scores]},
        lines=[[*pair] for pair in zip(edges, around, strict=True)],
        texts=[[text] for text in labels(texts, boxes.centers + boxes.sizes * [0.0, 0.0, LABEL_SHARE], color)],
    )
    return whole_scene(stamp_ns, drawn)


def truth_scene(truth: TrueBoxes) -> Any:
    """foxglove_msgs/SceneUpdate: the edges of every object's box, in the colour of the truth.

    A click tells its class: labels would cover those of the objects.
    """
    color = opaque(TRUTH)
    corners = box_corners(truth.centers, truth.sizes, truth.yaws)
    drawn = entities(
        [f"truth-{row}" for row in range(len(truth.labels))],
        truth.stamp_ns,
        truth.frame_id,
        {"class": truth.labels},
        lines=[[edges] for edges in outlines(corners, color, TRUTH_EDGE_PX)],
    )
    return whole_scene(truth.stamp_ns, drawn)
