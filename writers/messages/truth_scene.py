"""Truth drawn in 3D, beside the results: Foxglove draws no vision_msgs."""

from typing import Any

import numpy as np

from pipeline.core.geometry.box_edges import BOX_EDGES
from pipeline.core.geometry.boxes import box_corners
from pipeline.core.ros.messages import ROS2
from pipeline.core.true_boxes import TrueBoxes
from writers.palette import TRUTH

__all__ = ["truth_scene", "truth_scene_topic"]

LABEL_PX, EDGE_PX = 11.0, 1.5
LABEL_SHARE = 0.6
"""Height of a label above the centre, as a share of the height of the box: just above its roof."""

_EDGES = BOX_EDGES.reshape(-1).astype(np.uint32)
_LINE_LIST = 2  # LinePrimitive
_DELETE_ALL_ENTITIES = 1  # SceneEntityDeletion.ALL


def truth_scene_topic(topic: str) -> str:
    """Where the objects of a topic are drawn."""
    return f"{topic}/scene"


def truth_scene(truth: TrueBoxes) -> Any:
    """foxglove_msgs/SceneUpdate: the edges of every object's box and its class, in the colour of the truth."""
    stamp, color = ROS2.time(truth.stamp_ns), _foxglove("Color", *TRUTH, 1.0)
    corners = box_corners(truth.centers, truth.sizes, truth.yaws)
    entities = []
    for row, (points, label) in enumerate(zip(corners, truth.labels, strict=True)):
        x, y, z = truth.centers[row].tolist()
        place = ROS2.pose((x, y, z + LABEL_SHARE * truth.sizes[row, 2]))
        entities.append(
            _foxglove(
                "SceneEntity",
                timestamp=stamp,
                frame_id=truth.frame_id,
                id=f"truth-{row}",
                lifetime=ROS2.new("builtin_interfaces/msg/Duration", 0, 0),
                frame_locked=False,
                metadata=[_foxglove("KeyValuePair", "class", label)],
                arrows=[],
                cubes=[],
                spheres=[],
                cylinders=[],
                lines=[
                    _foxglove(
                        "LinePrimitive",
                        _LINE_LIST,
                        ROS2.pose((0.0, 0.0, 0.0)),
                        EDGE_PX,
                        True,
                        points,
                        color,
                        [],
                        _EDGES,
                    )
                ],
                triangles=[],
                texts=[_foxglove("TextPrimitive", place, True, LABEL_PX, True, color, label)],
                models=[],
            )
        )
    return _foxglove("SceneUpdate", [_foxglove("SceneEntityDeletion", stamp, _DELETE_ALL_ENTITIES, "")], entities)


def _foxglove(name: str, *values: Any, **fields: Any) -> Any:
    return ROS2.new(f"foxglove_msgs/msg/{name}", *values, **fields)
