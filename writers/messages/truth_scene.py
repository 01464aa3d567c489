"""Truth drawn in 3D, beside the results: Foxglove draws no vision_msgs."""

from typing import Any

from pipeline.core.geometry.boxes import box_corners
from pipeline.core.true_boxes import TrueBoxes
from writers.messages.scene_parts import entities, labels, opaque, outlines, whole_scene
from writers.palette import TRUTH

__all__ = ["truth_scene", "truth_scene_topic"]

LABEL_PX, EDGE_PX = 11.0, 1.5
LABEL_SHARE = 0.6
"""Height of a label above the centre, as a share of the height of the box: just above its roof."""


def truth_scene_topic(topic: str) -> str:
    """Where the objects of a topic are drawn."""
    return f"{topic}/scene"


def truth_scene(truth: TrueBoxes) -> Any:
    """foxglove_msgs/SceneUpdate: the edges of every object's box and its class, in the colour of the truth."""
    color, places = opaque(TRUTH), truth.centers.copy()
    places[:, 2] += LABEL_SHARE * truth.sizes[:, 2]
    corners = box_corners(truth.centers, truth.sizes, truth.yaws)
    drawn = entities(
        [f"truth-{row}" for row in range(len(truth.labels))],
        truth.stamp_ns,
        truth.frame_id,
        {"class": truth.labels},
        lines=[[edges] for edges in outlines(corners, color, EDGE_PX)],
        texts=[[text] for text in labels(truth.labels, places, color, LABEL_PX)],
    )
    return whole_scene(truth.stamp_ns, drawn)
