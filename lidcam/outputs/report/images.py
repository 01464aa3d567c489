"""Images of a page: the busiest moment with what was found, and the worst errors.

They show what a camera saw there, or the points from above where no camera did.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.readers.messages.deserialize import deserialize_as
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.results.result import Result
from lidcam.writers.images.canvas import Canvas, Color, Label
from lidcam.writers.palette import class_color
from lidcam.writers.report.collector import Moment

CLOUD_TOPIC, ANNOTATIONS = "/point_cloud_combined", "foxglove_msgs/msg/ImageAnnotations"

MISTAKE_COLORS = {"false": (60, 60, 255), "missed": (0, 215, 255)}
"""Colours (blue, green, red) of false and of missed boxes."""

TILE_PX = 288, 216
MARGIN = 0.6
"""Around a box, as a share of its size."""

MIN_PX = 24.0
MIN_REACH_M = 3.0
"""Least half width of a view from above, in lengths of the box."""


BUSIEST_PX, BESIDE_PX = 1200, 640
"""Width of the image of the busiest moment, where it is alone and where there are several."""

ABOVE_PX, ABOVE_SHARE = (1200, 600), 0.92
"""Size of its image from above, and the share of that which objects and points fill."""

MAX_IMAGES = 3
"""Images of the busiest moment, those with most objects."""

WIDE = 2.0
"""Aspect from which on an image stands alone."""

_LINE_LIST = 4  # Foxglove's PointsAnnotation: lines between pairs of points; else one closed line
_JPEG_QUALITY, _LETTER_PX = 82, 15


def busiest_images(result: Result, moment: Moment) -> list[tuple[str, str]]:
    """The images of a moment with boxes and labels: data URI and what shows it, those with most objects first.

    Without images it is shown from above; there is none where the result has no points either.
    """
    found = []
    for camera in result.rig.cameras:
        topic = f"/{camera.name}/annotations"
        for message in _at(result, [topic], moment.log_time_ns):
            drawn = deserialize_as(message, ANNOTATIONS, limits=result.config.limits)
            count = sum(line.type == _LINE_LIST for line in drawn.points)
            if (image := _image(result, camera, moment.log_time_ns)) is not None:
                found.append((count, camera, drawn, image))
    found = sorted(found, key=lambda one: -one[0])
    alone = bool(found) and (len(found) == 1 or found[0][3].shape[1] >= WIDE * found[0][3].shape[0])
    shown = [one for row, one in enumerate(found[: 1 if alone else MAX_IMAGES]) if row == 0 or one[0]]
    width_px = BUSIEST_PX if len(shown) == 1 else BESIDE_PX
    images = [(_annotated(image, drawn, width_px), camera.name) for _, camera, drawn, image in shown]
    if not images and (points := _points(result, moment.log_time_ns)) is not None:
        images = [(_scene_from_above(points, moment), "from above")]
    return [(_uri(image, _JPEG_QUALITY), name) for image, name in images]


def _annotated(image: U8, drawn: Any, width_px: int) -> U8:
    """An image with what was drawn on it for a viewer, blue green red."""
    width_px = min(width_px, image.shape[1])
    scale = width_px / image.shape[1]
    size_px = width_px, round(image.shape[0] * scale)
    canvas = Canvas(np.array(cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)), _LETTER_PX)
    for line in drawn.points:
        points = np.array([(point.x, point.y) for point in line.points]).reshape(-1, 2) * scale
        is_list = line.type == _LINE_LIST
        pieces = points.reshape(-1, 2, 2) if is_list else points[None]
        canvas.lines(
            pieces, _bgr(line.outline_color), 2 if is_list and line.outline_color.a == 1 else 1, closed=not is_list
        )
    canvas.labels(
        [
            Label(text.position.x * scale, text.position.y * scale, text.text, _bgr(text.text_color), -float(row))
            for row, text in enumerate(drawn.texts)
        ]
    )
    return canvas.pixels


def _bgr(color: Any) -> tuple[int, int, int]:
    return round(255 * color.b), round(255 * color.g), round(255 * color.r)


def _scene_from_above(points: F64, moment: Moment) -> U8:
    """The points of a moment and the outlines of its objects from above."""
    boxes = moment.boxes
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    shown = np.concatenate([np.percentile(points[:, :2], [2, 98], axis=0), corners[..., :2].reshape(-1, 2)])
    low, high = shown.min(0), shown.max(0)
    px_per_m = float((np.array(ABOVE_PX) / np.maximum(high - low, 1.0)).min()) * ABOVE_SHARE
    colors = [class_color(class_id).bytes_rgb[::-1] for class_id in boxes.class_ids.tolist()]
    return _from_above(points, corners, colors, (low + high) / 2, px_per_m, ABOVE_PX)


def mistake_image(result: Result, kind: str, mistake: Mapping[str, Any], log_time_ns: int) -> tuple[str, str] | None:
    """The image of an error as a data URI, and what shows it; None where the result has neither image nor points.

    `kind` is `false` or `missed`; the frame is the one in which the error is worst.
    """
    center = np.array([mistake[f"{axis}_m"] for axis in "xyz"])
    size = np.array([mistake[f"{side}_m"] for side in ("length", "width", "height")])
    corners = box_corners(center[None], size[None], np.array([np.radians(mistake["yaw_deg"])]))
    for camera, box in _views(result, corners):
        if (image := _image(result, camera, log_time_ns)) is not None:
            return _uri(cut_out(image, box, MISTAKE_COLORS[kind], TILE_PX)), camera.name
    points = _points(result, log_time_ns)
    if points is None:
        return None
    px_per_m = TILE_PX[1] / (2 * MIN_REACH_M * float(size[:2].max()))
    return _uri(_from_above(points, corners, [MISTAKE_COLORS[kind]], center[:2], px_per_m, TILE_PX)), "from above"


def _views(result: Result, corners: F64) -> Iterator[tuple[CameraSensor, F64]]:
    """The cameras that show a box, the one that shows it largest first."""
    found: list[tuple[float, CameraSensor, F64]] = []
    for camera in result.rig.cameras:
        (box,) = camera.model.project_boxes(camera.T_camera_site.apply(corners)).astype(np.float64)
        area = float((box[2] - box[0]) * (box[3] - box[1]))
        if np.isfinite(area):
            found.append((area, camera, box))
    for _, camera, box in sorted(found, key=lambda view: -view[0]):
        yield camera, box


def _image(result: Result, camera: CameraSensor, log_time_ns: int) -> U8 | None:
    """The image of a camera in a frame, blue green red."""
    topics = [f"/{camera.name}/image{suffix}" for suffix in ("", "/compressed")]
    for message in _at(result, topics, log_time_ns):
        try:
            rgb = decode_any_image(message, limits=result.config.limits).rgb
        except MessageError:  # the run has counted it
            continue
        return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), np.uint8)
    return None


def _at(result: Result, topics: Sequence[str], log_time_ns: int) -> Iterator[RawMessage]:
    return result.recording.messages(topics, start_ns=log_time_ns, stop_ns=log_time_ns + 1)


def _points(result: Result, log_time_ns: int) -> F64 | None:
    for message in _at(result, [CLOUD_TOPIC], log_time_ns):
        return decode_pointcloud2(message, limits=result.config.limits).xyz.astype(np.float64)
    return None


def cut_out(image: U8, box: F64, color: Sequence[int], size_px: tuple[int, int]) -> U8:
    """The part of an image around a box, with the box, as a tile of that width and height."""
    height, width = image.shape[:2]
    middle = (box[:2] + box[2:]) / 2
    reach = np.maximum(box[2:] - box[:2], MIN_PX) * (0.5 + MARGIN)
    reach = np.array(size_px) * max(reach / np.array(size_px))
    low = np.clip(middle - reach, 0, np.maximum(np.array([width, height]) - 2 * reach, 0))
    high = np.minimum(low + 2 * reach, [width, height])
    left, top, right, bottom = (int(edge) for edge in (*np.floor(low), *np.ceil(high)))
    tile = cv2.resize(image[top:bottom, left:right], size_px, interpolation=cv2.INTER_AREA)
    scale = np.array(size_px) / [right - left, bottom - top]
    first, last = (box[:2] - [left, top]) * scale, (box[2:] - [left, top]) * scale
    cv2.rectangle(tile, first.astype(int).tolist(), last.astype(int).tolist(), color, 2)
    return np.asarray(tile, np.uint8)


def _from_above(
    points: F64, corners: F64, colors: Sequence[Color], middle: F64, px_per_m: float, size_px: tuple[int, int]
) -> U8:
    """Points (N, 3) and the outlines of boxes (K, 8, 3) around a place, with x to the right; blue green red."""
    canvas = Canvas(np.array(Canvas.blank(*size_px, _LETTER_PX).pixels[..., ::-1]), _LETTER_PX)

    def pixels(places: F64) -> F64:
        return np.asarray((places[..., :2] - middle) * [1, -1] * px_per_m + np.array(size_px) / 2)

    seen = np.floor(pixels(points)).astype(np.intp)
    seen = seen[((seen >= 0) & (seen < size_px)).all(1)]
    canvas.pixels[seen[:, 1], seen[:, 0]] = 150
    for outline, color in zip(pixels(corners[:, :4]), colors, strict=True):
        canvas.lines([outline], color, 2, closed=True)
    return canvas.pixels


def _uri(tile: U8, quality: int = 75) -> str:
    _, jpeg = cv2.imencode(".jpg", tile, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode()
