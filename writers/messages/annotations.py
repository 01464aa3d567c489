"""The overlay of one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import F32
from pipeline.core.frame import FrameResult
from pipeline.core.rig import CameraSensor
from pipeline.core.ros.messages import ROS2
from writers.drawing import drawn_boxes_2d, object_colors, object_edges, strong_objects

__all__ = ["image_annotations"]

LABEL_SHARE = 1 / 24
"""Height of the letters as a share of the image's: legible in a panel of 200 px."""

_LINE_SHARE, _FAINT_ALPHA = 1 / 300, 0.5
_LINE_LOOP, _LINE_LIST = 2, 4  # PointsAnnotation


def image_annotations(result: FrameResult, camera: CameraSensor, class_names: Sequence[str], *, stamp_ns: int) -> Any:
    """The fused objects as the lens bends them, and the camera's 2D boxes.

    An object has the colour of its class, a 2D box is green if it belongs to an object and amber if not; its label is
    the object's class and score, else the detector's. Boxes lower than the letters have no label. Every stamp is the
    image's: viewers pair by equality.
    """
    stamp, height_px = ROS2.time(stamp_ns), camera.model.height_px
    clear = _new("Color", 0.0, 0.0, 0.0, 0.0)

    def lines(kind: int, points: F32, rgba: Sequence[float], thickness: float) -> Any:
        corners = [_new("Point2", x, y) for x, y in points.tolist()]
        return _new("PointsAnnotation", stamp, kind, corners, _new("Color", *rgba), [], clear, thickness, [])

    segments, rows = object_edges(result, camera)
    alphas = [1.0 if strong else _FAINT_ALPHA for strong in strong_objects(result).tolist()]
    outlines = [
        lines(_LINE_LIST, segments[rows == row].reshape(-1, 2), (*color, alpha), height_px * _LINE_SHARE)
        for row, (color, alpha) in enumerate(zip(object_colors(result).tolist(), alphas, strict=True))
        if (rows == row).any()
    ]
    texts, letters_px = [], height_px * LABEL_SHARE
    drawn = drawn_boxes_2d(result, camera.name, class_names)
    for (left, top, right, bottom), rgb, text in zip(drawn.xyxy.tolist(), drawn.colors, drawn.labels, strict=True):
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float32)
        outlines.append(lines(_LINE_LOOP, corners, (*rgb, 1.0), height_px * _LINE_SHARE))
        if bottom - top >= letters_px:
            place = _new("Point2", max(left, 0.0), max(top, letters_px))
            ink, ground = _new("Color", *rgb, 1.0), _new("Color", 0.0, 0.0, 0.0, 0.6)
            texts.append(_new("TextAnnotation", stamp, place, text, letters_px, ink, ground, []))
    return _new("ImageAnnotations", stamp, [], outlines, texts, [])


def _new(name: str, *values: Any) -> Any:
    return ROS2.new(f"foxglove_msgs/msg/{name}", *values)
