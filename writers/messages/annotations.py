"""The overlay of one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.writers.drawing import (
    DrawnBoxes2D,
    DrawnObjects,
    ObjectEdges,
    drawn_boxes_2d,
    labels_in_the_clear,
    with_outlines,
)
from lidcam.writers.messages.parts import colors, opaque, split

LABEL_SHARE = 1 / 24
"""Height of the letters as a share of the image's shorter side: legible in a panel of 200 px."""

_LETTER_WIDTH = 0.6
"""Width of a letter, as a share of its height."""

_LINE_SHARE, _FAINT_ALPHA, _BEHIND_ALPHA = 1 / 300, 0.5, 0.45
_LINE_LOOP, _LINE_LIST = 2, 4  # PointsAnnotation
_CORNERS = np.array([0, 1, 2, 1, 2, 3, 0, 3])  # x and y of the corners of left, top, right, bottom


def image_annotations(drawn: DrawnObjects, camera: CameraSensor, edges: ObjectEdges, *, stamp_ns: int) -> Any:
    """The fused objects as the lens of a camera bends them, and its 2D boxes.

    An object has the colour of its class, and a thinner line if no lidar shows it. A 2D box is green and faint if it
    belongs to an object, whose 3D box is drawn as well, and amber if not; its label is the object's class with track
    and speed, or with the score if it has no track, else the detector's. A strong object without a 2D box has its label
    at its 3D box. A label that would cover that of a larger box is left out. Every stamp is the image's: viewers pair
    by equality.
    """
    boxes, time = drawn_boxes_2d(drawn, camera.name), ROS2.time(stamp_ns)
    line_px = min(camera.model.width_px, camera.model.height_px) * _LINE_SHARE
    lines = [*_objects(drawn, edges, line_px, time), *_rectangles(boxes, line_px, time)]
    return ROS2.new(
        "foxglove_msgs/msg/ImageAnnotations",
        time,
        [],
        lines,
        _texts(camera, with_outlines(boxes, drawn, edges), time),
        [],
    )


def _objects(drawn: DrawnObjects, edges: ObjectEdges, line_px: float, time: Any) -> list[Any]:
    """The edges of each object in an image."""
    segments, of_piece = edges
    pieces = np.bincount(of_piece)  # they come object after object
    rows = np.flatnonzero(pieces)
    alphas = np.where(drawn.strong & ~drawn.predicted, 1.0, _FAINT_ALPHA)
    rgba = np.concatenate([drawn.colors, alphas[:, None]], 1)
    shares = np.where(drawn.thin, 0.5, 1.0)
    return _lines(_LINE_LIST, segments.reshape(-1, 2), 2 * pieces[rows], rgba[rows], line_px * shares[rows], time)


def _rectangles(boxes: DrawnBoxes2D, line_px: float, time: Any) -> list[Any]:
    corners, rgb = boxes.xyxy[:, _CORNERS].reshape(-1, 2), np.array(boxes.colors).reshape(-1, 3)
    matched, rgba = boxes.are_matched, opaque(rgb)
    rgba[matched, 3] = _BEHIND_ALPHA
    return _lines(_LINE_LOOP, corners, np.full(len(boxes.labels), 4), rgba, line_px * np.where(matched, 0.5, 1.0), time)


def _lines(kind: int, points: F32, counts: I64, rgba: F64, thickness_px: F64, time: Any) -> list[Any]:
    return ROS2.rows(
        "foxglove_msgs/msg/PointsAnnotation",
        len(counts),
        timestamp=time,
        type=kind,
        points=split(ROS2.rows_of_numbers("foxglove_msgs/msg/Point2", points), counts),
        outline_color=colors(rgba),
        thickness=thickness_px,
    )


def _texts(camera: CameraSensor, boxes: DrawnBoxes2D, time: Any) -> list[Any]:
    letters_px = min(camera.model.width_px, camera.model.height_px) * LABEL_SHARE
    found = [*_label_places(boxes, camera, letters_px)]
    return ROS2.rows(
        "foxglove_msgs/msg/TextAnnotation",
        len(found),
        timestamp=time,
        position=[ROS2.new("foxglove_msgs/msg/Point2", *place) for _, place in found],
        text=[boxes.labels[row] for row, _ in found],
        font_size=letters_px,
        text_color=[ROS2.new("foxglove_msgs/msg/Color", *boxes.colors[row], 1.0) for row, _ in found],
        background_color=ROS2.new("foxglove_msgs/msg/Color", 0.0, 0.0, 0.0, 0.6),
    )


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
