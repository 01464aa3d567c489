"""The overlay of one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import F32
from pipeline.core.frame import FrameResult
from pipeline.core.rig import CameraSensor
from pipeline.core.ros.messages import ROS2
from writers.drawing import (
    DrawnBoxes2D,
    ObjectEdges,
    drawn_boxes_2d,
    labels_in_the_clear,
    object_colors,
    placed_objects,
    strong_objects,
)

__all__ = ["image_annotations"]

LABEL_SHARE = 1 / 24
"""Height of the letters as a share of the image's: legible in a panel of 200 px."""

_LETTER_WIDTH = 0.6
"""Of a letter, as a share of its height."""

_LINE_SHARE, _FAINT_ALPHA = 1 / 300, 0.5
_LINE_LOOP, _LINE_LIST = 2, 4  # PointsAnnotation


def image_annotations(
    result: FrameResult, camera: CameraSensor, edges: ObjectEdges, class_names: Sequence[str], *, stamp_ns: int
) -> Any:
    """The fused objects as the lens bends them, and the camera's 2D boxes.

    An object has the colour of its class, and a thinner line if the cameras alone place it. A 2D box is green if it
    belongs to an object and amber if not; its label is the object's class and score, else the detector's. A label that
    would cover that of a larger box is left out.
    Every stamp is the image's: viewers pair by equality.
    """
    stamp, height_px = ROS2.time(stamp_ns), camera.model.height_px
    clear = _new("Color", 0.0, 0.0, 0.0, 0.0)

    def lines(kind: int, points: F32, rgba: Sequence[float], thickness: float) -> Any:
        return _new("PointsAnnotation", stamp, kind, points, _new("Color", *rgba), [], clear, thickness, [])

    outlines = []
    segments, rows = edges
    if len(rows):
        alphas = np.where(strong_objects(result), 1.0, _FAINT_ALPHA).tolist()
        widths_px = (height_px * _LINE_SHARE * np.where(placed_objects(result), 0.5, 1.0)).tolist()
        colors = object_colors(result).tolist()
        first = np.flatnonzero(np.r_[True, rows[1:] != rows[:-1]])  # the pieces come object after object
        for row, pieces in zip(rows[first].tolist(), np.split(segments, first[1:]), strict=True):
            outlines.append(lines(_LINE_LIST, pieces.reshape(-1, 2), (*colors[row], alphas[row]), widths_px[row]))
    drawn = drawn_boxes_2d(result, camera.name, class_names)
    for (left, top, right, bottom), rgb in zip(drawn.xyxy.tolist(), drawn.colors, strict=True):
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float32)
        outlines.append(lines(_LINE_LOOP, corners, (*rgb, 1.0), height_px * _LINE_SHARE))
    texts, letters_px = [], height_px * LABEL_SHARE
    for row, (left, bottom) in _label_places(drawn, camera, letters_px):
        ink, ground = _new("Color", *drawn.colors[row], 1.0), _new("Color", 0.0, 0.0, 0.0, 0.6)
        place = _new("Point2", left, bottom)
        texts.append(_new("TextAnnotation", stamp, place, drawn.labels[row], letters_px, ink, ground, []))
    return _new("ImageAnnotations", stamp, [], outlines, texts, [])


def _label_places(
    drawn: DrawnBoxes2D, camera: CameraSensor, letters_px: float
) -> Iterator[tuple[int, tuple[float, float]]]:
    """Row and bottom left corner of each label: above its box and in the image, where it covers no other."""
    size_px = np.array([camera.model.width_px, camera.model.height_px], np.float64)
    sizes = np.array([[len(label) * _LETTER_WIDTH, 1.0] for label in drawn.labels]).reshape(-1, 2) * letters_px
    low, heights = drawn.xyxy[:, :2].astype(np.float64), drawn.xyxy[:, 3] - drawn.xyxy[:, 1]
    places = np.clip(low + sizes * [0.5, -0.5], sizes / 2, size_px - sizes / 2)
    for row in labels_in_the_clear(places, sizes, heights.astype(np.float64)):
        if heights[row] >= letters_px / 2:
            left, bottom = (places[row] + sizes[row] * [-0.5, 0.5]).tolist()
            yield row, (left, bottom)


def _new(name: str, *values: Any) -> Any:
    return ROS2.new(f"foxglove_msgs/msg/{name}", *values)
