"""The overlay of one camera's image: foxglove_msgs/ImageAnnotations."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.detections import Boxes2D, Matches
from pipeline.core.ros.messages import ROS2
from writers.palette import CAMERA_ONLY, LIDAR_ONLY, MATCHED, Rgb

__all__ = ["image_annotations"]

LABEL_PX = 12.0
_LINE_PX, _MATCHED_LINE_PX = 1.5, 2.5
_LINE_LOOP = 2  # PointsAnnotation.LINE_LOOP


def image_annotations(
    boxes: Boxes2D | None, matches: Matches | None, class_names: Sequence[str], *, stamp_ns: int
) -> Any:
    """2D boxes and projected 3D boxes: matched pairs in green, other boxes in the colour of their sensor.

    A 2D box is labelled at its top with class and score (and IoU if matched), an unmatched projection at its bottom
    with `lidar`. Every stamp is the image's: viewers pair by equality.
    """
    stamp = ROS2.time(stamp_ns)
    outlines, texts = [], []

    def outline(xyxy: Sequence[float], rgb: Rgb, thickness: float) -> None:
        left, top, right, bottom = xyxy
        corners = [_new("Point2", x, y) for x, y in ((left, top), (right, top), (right, bottom), (left, bottom))]
        line, fill = _new("Color", *rgb, 1.0), _new("Color", 0.0, 0.0, 0.0, 0.0)
        outlines.append(_new("PointsAnnotation", stamp, _LINE_LOOP, corners, line, [], fill, thickness, []))

    def label(x: float, y: float, text: str, rgb: Rgb) -> None:
        ink, ground = _new("Color", *rgb, 1.0), _new("Color", 0.0, 0.0, 0.0, 0.6)
        texts.append(_new("TextAnnotation", stamp, _new("Point2", x, y), text, LABEL_PX, ink, ground, []))

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
    return _new("ImageAnnotations", stamp, [], outlines, texts, [])


def _new(name: str, *values: Any) -> Any:
    return ROS2.new(f"foxglove_msgs/msg/{name}", *values)
