"""The image of a camera with 2D boxes, 3D boxes as the lens bends them, and which of them belong together."""

from typing import Literal

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, U8
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.writers.drawing import DrawnObjects, drawn_boxes_2d, object_edges
from lidcam.writers.images.canvas import TEXT, Canvas, Label
from lidcam.writers.palette import MATCHED, class_color

Look = Literal["full", "compact"]
"""`compact`: thin lines and short texts, without the lines between what belongs together."""


def draw_camera(
    drawn: DrawnObjects,
    camera: CameraSensor,
    image: U8 | None,
    *,
    width_px: int,
    title: str,
    look: Look,
) -> U8:
    """The image of a camera in a frame, (H, W, 3), red, green, blue.

    Args:
        drawn: The objects of the frame.
        camera: The camera.
        image: (H, W, 3) its image; None where there is none.
        width_px: Width of the image; its height follows from the camera's.
        title: Stands in the corner.
        look: Whether there is room for all.
    """
    scale, is_full = width_px / camera.model.width_px, look == "full"
    canvas = _canvas(image, width_px, round(camera.model.height_px * scale))
    result, objects, strong, thin = drawn.result, drawn.boxes, drawn.strong, drawn.thin
    pieces, rows = object_edges(result, [camera.name])[camera.name]
    edges = [pieces[rows == row] * np.float32(scale) for row in range(len(objects))]
    colors = np.round(drawn.colors * 255).astype(int).tolist()
    depths = np.asarray(result.views[camera.name].T_camera_site.apply(objects.centers))[:, 2]
    for row in np.argsort(-depths, kind="stable").tolist():
        is_wide = is_full and strong[row]
        canvas.lines(edges[row], colors[row], 2 if is_wide and not thin[row] else 1, shade=is_wide)
    boxes = drawn_boxes_2d(drawn, camera.name)
    labels = []
    for box, color, text, row, overlap in zip(boxes.xyxy * scale, *boxes[1:], strict=True):
        left, top, right, bottom = (np.floor(box) + 0.5).tolist()  # sharp lines
        corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
        canvas.lines([corners], color.bytes_rgb, closed=True, shade=is_full)
        if is_full and color is MATCHED:
            text = f"{text}, IoU {overlap:.2f}"
            ends = [(box[:2] + box[2:]) / 2, *(_around(edges[row]).reshape(-1, 2, 2).mean(1))]
            canvas.lines([ends], MATCHED.bytes_rgb, shade=1)
            canvas.dots(ends, MATCHED.bytes_rgb, 2.5)
        labels.append(Label(left, top - 2, text, color.bytes_rgb, 2.0 + (color is MATCHED)))
    class_ids = objects.class_ids.tolist()
    for row in np.flatnonzero(strong).tolist():
        for left, top, *_ in _around(edges[row]).tolist() if row not in boxes.objects else ():
            labels.append(Label(left, top - 2, drawn.labels[row], class_color(class_ids[row]).bytes_rgb, 1.0))
    if not is_full:  # without speeds
        labels = [label._replace(text=label.text.partition(", ")[0]) for label in labels]
    canvas.labels([Label(0.0, 0.0, title, TEXT, np.inf), *labels])
    return canvas.pixels


def _canvas(image: U8 | None, width_px: int, height_px: int) -> Canvas:
    letter_px = min(max(round(height_px / 45), 14), 40)
    if image is None:
        canvas = Canvas.blank(width_px, height_px, letter_px)
        canvas.text(width_px / 2, height_px / 2, "no image", share=0.5)
        return canvas
    way = cv2.INTER_AREA if image.shape[1] > width_px else cv2.INTER_LINEAR
    return Canvas(np.array(cv2.resize(image, (width_px, height_px), interpolation=way)), letter_px)


def _around(pieces: F32) -> F64:
    """(1, 4) left, top, right, bottom of lines (M, 2, 2); (0, 4) without any."""
    points = pieces.reshape(-1, 2).astype(np.float64)
    return np.concatenate([points.min(0), points.max(0)])[None] if len(points) else np.zeros((0, 4))
