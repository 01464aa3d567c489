"""What is drawn over one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from pipeline.core.detections import Boxes2D, Matches
from writers.messages.definitions import message_type
from writers.messages.ros_messages import time
from writers.palette import CAMERA_ONLY, LIDAR_ONLY, MATCHED, Rgb

__all__ = ["image_annotations"]

LABEL_PX = 12.0
_LINE_PX, _MATCHED_LINE_PX = 1.5, 2.5


class _Types(NamedTuple):
    point: Any
    color: Any
    outline: Any
    text: Any
    annotations: Any


@cache
def _types() -> _Types:
    names = ("Point2", "Color", "PointsAnnotation", "TextAnnotation", "ImageAnnotations")
    return _Types(*(message_type(f"foxglove_msgs/msg/{name}") for name in names))


def image_annotations(
    boxes: Boxes2D | None, matches: Matches | None, class_names: Sequence[str], *, stamp_ns: int
) -> Any:
    """2D boxes and projected 3D boxes; a pair that was matched is green, what one sensor alone saw has its colour.

    A 2D box is labelled at its top with class and score (and overlap if matched), an unmatched projection at its
    bottom with `lidar`. Every stamp is the image's: viewers pair by equality.
    """
    types, stamp = _types(), time(stamp_ns)
    outlines, texts = [], []

    def outline(xyxy: Sequence[float], color: Rgb, thickness: float) -> None:
        left, top, right, bottom = xyxy
        corners = [types.point(x, y) for x, y in ((left, top), (right, top), (right, bottom), (left, bottom))]
        line, fill = types.color(*color, 1.0), types.color(0.0, 0.0, 0.0, 0.0)
        outlines.append(types.outline(stamp, types.outline.LINE_LOOP, corners, line, [], fill, thickness, []))

    def label(x: float, y: float, text: str, color: Rgb) -> None:
        ink, ground = types.color(*color, 1.0), types.color(0.0, 0.0, 0.0, 0.6)
        texts.append(types.text(stamp, types.point(x, y), text, LABEL_PX, ink, ground, []))

    pairs = matches.pairs.tolist() if matches is not None else []
    overlap = {row: iou for (_, row), iou in zip(pairs, matches.iou.tolist(), strict=True)} if matches else {}
    matched_3d = {row for row, _ in pairs}
    if matches is not None:
        for row in np.flatnonzero(np.isfinite(matches.projected_xyxy).all(1)).tolist():
            xyxy = matches.projected_xyxy[row].tolist()
            outline(xyxy, MATCHED if row in matched_3d else LIDAR_ONLY, _LINE_PX)
            if row not in matched_3d:
                label(xyxy[0], xyxy[3] + LABEL_PX, "lidar", LIDAR_ONLY)
    if boxes is not None:
        columns = zip(boxes.xyxy.tolist(), boxes.scores.tolist(), boxes.class_ids.tolist(), strict=True)
        for row, (xyxy, score, class_id) in enumerate(columns):
            color = MATCHED if row in overlap else CAMERA_ONLY
            outline(xyxy, color, _MATCHED_LINE_PX if row in overlap else _LINE_PX)
            pair = f", IoU {overlap[row]:.2f}" if row in overlap else ""
            label(xyxy[0], xyxy[1], f"{class_names[class_id]} {score:.2f}{pair}", color)
    return types.annotations(stamp, [], outlines, texts, [])
