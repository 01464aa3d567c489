"""Boxes that the cameras alone place, drawn in 3D: Foxglove draws no vision_msgs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import UNIT_CORNERS
from writers.messages.parts import box_poses
from writers.messages.scene_parts import ellipses, entities, labels, opaque, outlines, whole_scene
from writers.palette import CAMERA_ONLY
from writers.uncertainty import ground_ellipses

__all__ = ["PLACED", "PLACED_SCENE", "placed_scene"]

PLACED = "/cameras/detections"
PLACED_SCENE = "/cameras/scene"
"""Topics of the boxes and of what is drawn of them; they have a message where a camera has 2D boxes."""

EDGE_PX = 1.0
LABEL_SHARE = 0.6
"""Height of a label above the centre, as a share of the height of the box: just above its roof."""


def placed_scene(boxes: Boxes3D, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """foxglove_msgs/SceneUpdate: edges, class and score of each box, and an ellipse of one standard deviation."""
    names, scores = [class_names[class_id] for class_id in boxes.class_ids.tolist()], boxes.scores.tolist()
    places = boxes.centers + np.array([0.0, 0.0, LABEL_SHARE]) * boxes.sizes[:, 2:]
    color = opaque(CAMERA_ONLY)
    edges = outlines(UNIT_CORNERS / 2 * boxes.sizes[:, None], color, EDGE_PX, poses=box_poses(boxes))
    texts = [f"{name} {score:.2f}" for name, score in zip(names, scores, strict=True)]
    drawn = entities(
        [f"placed-{row}" for row in range(len(boxes))],
        stamp_ns,
        boxes.frame_id,
        {"class": names, "score": [f"{score:.4f}" for score in scores]},
        lines=[[*pair] for pair in zip(edges, ellipses(ground_ellipses(boxes), color, EDGE_PX), strict=True)],
        texts=[[text] for text in labels(texts, places, color)],
    )
    return whole_scene(stamp_ns, drawn)
