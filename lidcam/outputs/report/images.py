"""The worst errors as images: what a camera saw there, or the points from above where no camera did."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F64, U8
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.results.result import Result

CLOUD_TOPIC = "/point_cloud_combined"

MISTAKE_COLORS = {"false": (60, 60, 255), "missed": (0, 215, 255)}
"""Of the boxes, blue green red: what was reported and is not there, what is there and was not reported."""

TILE_PX = 288, 216
MARGIN = 0.6
"""Around a box, as a share of its size."""

MIN_PX = 24.0
MIN_REACH_M = 3.0
"""Least half width of a view from above, in lengths of the box."""


def mistake_image(result: Result, kind: str, mistake: Mapping[str, Any], log_time_ns: int) -> tuple[str, str] | None:
    """The image of an error as a data URI, and what shows it; None where the result has neither image nor points.

    Args:
        result: The open result.
        kind: `false` or `missed`.
        mistake: Its figures.
        log_time_ns: Log time of the frame in which it is worst.
    """
    center = np.array([mistake[f"{axis}_m"] for axis in "xyz"])
    size = np.array([mistake[f"{side}_m"] for side in ("length", "width", "height")])
    corners = box_corners(center[None], size[None], np.array([np.radians(mistake["yaw_deg"])]))
    for camera, box in _views(result, corners):
        if (image := _image(result, camera, log_time_ns)) is not None:
            return _uri(cut_out(image, box, MISTAKE_COLORS[kind], TILE_PX)), camera.name
    points = _points(result, log_time_ns)
    return None if points is None else (_uri(_from_above(points, corners[0], size, MISTAKE_COLORS[kind])), "from above")


def _views(result: Result, corners: F64) -> Iterator[tuple[CameraSensor, F64]]:
    """The cameras that show a box, the one that shows it largest first."""
    found: list[tuple[float, CameraSensor, F64]] = []
    for camera in result.rig.cameras:
        (box,) = camera.project_boxes(corners, result.rig.site_frame).astype(np.float64)
        area = float((box[2] - box[0]) * (box[3] - box[1]))
        if np.isfinite(area):
            found.append((area, camera, box))
    for _, camera, box in sorted(found, key=lambda view: -view[0]):
        yield camera, box


def _image(result: Result, camera: CameraSensor, log_time_ns: int) -> U8 | None:
    """The image of a camera in a frame, blue green red."""
    topics = [f"/{camera.name}/image{suffix}" for suffix in ("", "/compressed")]
    for message in result.recording.messages(topics, start_ns=log_time_ns, stop_ns=log_time_ns + 1):
        try:
            rgb = decode_any_image(message, limits=result.config.limits).rgb
        except MessageError:  # the run has counted it
            continue
        return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), np.uint8)
    return None


def _points(result: Result, log_time_ns: int) -> F64 | None:
    for message in result.recording.messages([CLOUD_TOPIC], start_ns=log_time_ns, stop_ns=log_time_ns + 1):
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


def _from_above(points: F64, corners: F64, size: F64, color: Sequence[int]) -> U8:
    """The points around a box, seen from above with x to the right, and its outline."""
    tile = np.full((TILE_PX[1], TILE_PX[0], 3), 30, np.uint8)
    middle, px_per_m = corners[:, :2].mean(0), TILE_PX[1] / (2 * MIN_REACH_M * float(size[:2].max()))
    pixels = np.floor(((points[:, :2] - middle) * [1, -1]) * px_per_m + np.array(TILE_PX) / 2).astype(np.intp)
    inside = ((pixels >= 0) & (pixels < TILE_PX)).all(1)
    tile[pixels[inside, 1], pixels[inside, 0]] = 210
    outline = ((corners[:4, :2] - middle) * [1, -1] * px_per_m + np.array(TILE_PX) / 2).astype(np.int32)
    cv2.polylines(tile, [cv2.convexHull(outline)], True, color, 2, cv2.LINE_AA)
    return tile


def _uri(tile: U8) -> str:
    _, jpeg = cv2.imencode(".jpg", tile, [cv2.IMWRITE_JPEG_QUALITY, 75])
    return "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode()
