"""The overlay of one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.frame import FrameResult
from pipeline.core.rig import CameraSensor
from pipeline.core.ros.columns import Columns, Lists
from writers.drawing import (
    DrawnBoxes2D,
    ObjectEdges,
    drawn_boxes_2d,
    labels_in_the_clear,
    object_colors,
    placed_objects,
    strong_objects,
)
from writers.messages.parts import times
from writers.messages.scene_parts import opaque

__all__ = ["image_annotations"]

LABEL_SHARE = 1 / 24
"""Height of the letters as a share of the image's: legible in a panel of 200 px."""

_LETTER_WIDTH = 0.6
"""Of a letter, as a share of its height."""

_LINE_SHARE, _FAINT_ALPHA = 1 / 300, 0.5
_LINE_LOOP, _LINE_LIST = 2, 4  # PointsAnnotation
_CORNERS = np.array([0, 1, 2, 1, 2, 3, 0, 3])  # x and y of the corners of left, top, right, bottom
_NONE = np.zeros(0, np.int64)


def image_annotations(
    result: FrameResult,
    cameras: Sequence[CameraSensor],
    edges: Mapping[str, ObjectEdges],
    class_names: Sequence[str],
    *,
    stamps_ns: Sequence[int],
) -> Columns:
    """The fused objects as the lens of each camera bends them, and its 2D boxes.

    An object has the colour of its class, and a thinner line if the cameras alone place it. A 2D box is green if it
    belongs to an object and amber if not; its label is the object's class and score, else the detector's. A label that
    would cover that of a larger box is left out.
    Every stamp is the image's: viewers pair by equality.
    """
    boxes = [drawn_boxes_2d(result, camera.name, class_names) for camera in cameras]
    objects, object_counts = _objects(result, cameras, [edges[camera.name] for camera in cameras], stamps_ns)
    rectangles, counts = _rectangles(cameras, boxes, stamps_ns)
    texts, text_counts = _texts(cameras, boxes, stamps_ns)
    return Columns(
        "foxglove_msgs/msg/ImageAnnotations",
        len(cameras),
        timestamp=times(stamps_ns),
        points=Lists(objects, object_counts, Lists(rectangles, counts)),
        texts=Lists(texts, text_counts),
    )


def _objects(
    result: FrameResult, cameras: Sequence[CameraSensor], edges: Sequence[ObjectEdges], stamps_ns: Sequence[int]
) -> tuple[Columns, Sequence[int]]:
    """The edges of each object in each image, and the number of objects in each."""
    piece_rows = np.concatenate([_NONE, *(rows for _, rows in edges)])
    piece_images = np.repeat(np.arange(len(cameras)), [len(rows) for _, rows in edges])
    is_first = np.ones(len(piece_rows), bool)  # the pieces come object after object
    is_first[1:] = (piece_rows[1:] != piece_rows[:-1]) | (piece_images[1:] != piece_images[:-1])
    row, of_image = piece_rows[is_first], piece_images[is_first]
    pieces = np.bincount(np.cumsum(is_first) - 1, minlength=len(row))
    alphas = np.where(strong_objects(result), 1.0, _FAINT_ALPHA)
    colors = np.concatenate([object_colors(result), alphas[:, None]], 1)
    shares = np.where(placed_objects(result), 0.5, 1.0)
    lines = _lines(
        _LINE_LIST,
        Lists(
            np.concatenate([np.zeros((0, 2), np.float32), *(segments.reshape(-1, 2) for segments, _ in edges)]),
            2 * pieces,
        ),
        colors[row],
        _heights_px(cameras)[of_image] * _LINE_SHARE * shares[row],
        [stamps_ns[image] for image in of_image.tolist()],
    )
    return lines, np.bincount(of_image, minlength=len(cameras)).tolist()


def _rectangles(
    cameras: Sequence[CameraSensor], boxes: Sequence[DrawnBoxes2D], stamps_ns: Sequence[int]
) -> tuple[Columns, Sequence[int]]:
    """The 2D boxes of each image, and their number."""
    counts = [len(drawn.labels) for drawn in boxes]
    of_image = np.repeat(np.arange(len(cameras)), counts)
    xyxy = np.concatenate([np.zeros((0, 4), np.float32), *(drawn.xyxy for drawn in boxes)])
    rectangles = _lines(
        _LINE_LOOP,
        Lists(xyxy[:, _CORNERS].reshape(-1, 2), 4),
        opaque(np.array([rgb for drawn in boxes for rgb in drawn.colors]).reshape(-1, 3)),
        _heights_px(cameras)[of_image] * _LINE_SHARE,
        [stamps_ns[image] for image in of_image.tolist()],
    )
    return rectangles, counts


def _lines(kind: int, points: Lists, colors: F64, thickness_px: F64, stamps_ns: Sequence[int]) -> Columns:
    return Columns(
        "foxglove_msgs/msg/PointsAnnotation",
        len(stamps_ns),
        timestamp=times(stamps_ns),
        type=kind,
        points=points,
        outline_color=colors,
        thickness=thickness_px,
    )


def _texts(
    cameras: Sequence[CameraSensor], boxes: Sequence[DrawnBoxes2D], stamps_ns: Sequence[int]
) -> tuple[Columns, Sequence[int]]:
    """The labels in each image, and their number."""
    counts, places, texts, colors, letters_px, stamps = [], [], [], [], [], []
    for camera, drawn, stamp_ns in zip(cameras, boxes, stamps_ns, strict=True):
        letter_px = camera.model.height_px * LABEL_SHARE
        found = list(_label_places(drawn, camera, letter_px)) if drawn.labels else []
        counts.append(len(found))
        for row, place in found:
            places.append(place)
            texts.append(drawn.labels[row])
            colors.append((*drawn.colors[row], 1.0))
            letters_px.append(letter_px)
            stamps.append(stamp_ns)
    rows = Columns(
        "foxglove_msgs/msg/TextAnnotation",
        len(texts),
        timestamp=times(stamps),
        position=np.array(places).reshape(-1, 2),
        text=texts,
        font_size=np.array(letters_px),
        text_color=np.array(colors).reshape(-1, 4),
        background_color=(0.0, 0.0, 0.0, 0.6),
    )
    return rows, counts


def _heights_px(cameras: Sequence[CameraSensor]) -> F64:
    return np.array([camera.model.height_px for camera in cameras], np.float64)


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
