"""What the cameras alone place in 3D, drawn: Foxglove draws no vision_msgs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes3D
from pipeline.core.ros.messages import ROS2
from writers.messages.detections import box_poses
from writers.messages.scene import ellipse, label, outline, scene_entity, whole_scene
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
    stamp = ROS2.time(stamp_ns)
    places = boxes.centers + np.array([0.0, 0.0, LABEL_SHARE]) * boxes.sizes[:, 2:]
    columns = zip(
        box_poses(boxes),
        boxes.sizes.tolist(),
        boxes.class_ids.tolist(),
        boxes.scores.tolist(),
        places.tolist(),
        ground_ellipses(boxes),
        strict=True,
    )
    entities = [
        scene_entity(
            f"placed-{row}",
            stamp,
            boxes.frame_id,
            {"class": class_names[class_id], "score": f"{score:.4f}"},
            lines=[outline(pose, size, CAMERA_ONLY, EDGE_PX), ellipse(points, CAMERA_ONLY, EDGE_PX)],
            texts=[label(f"{class_names[class_id]} {score:.2f}", ROS2.pose(place), CAMERA_ONLY)],
        )
        for row, (pose, size, class_id, score, place, points) in enumerate(columns)
    ]
    return whole_scene(stamp, entities)
