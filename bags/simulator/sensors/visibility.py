"""Visibility of each mover in an image: the clean 2D truth beside the simulated detector."""

from dataclasses import dataclass

import numpy as np

from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.world.motion import Poses
from lidcam.bags.simulator.world.mover import Mover, Part, placed_vertices
from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.camera import NEAR_M, CameraModel

EDGES = ((0, 1), (1, 2), (2, 0))
"""The corners of each edge of a triangle."""


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Visibility of each of M movers in an image.

    Boxes are left, top, right, bottom in pixels, counted from the image's corner.

    Attributes:
        visible_xyxy: (M, 4) float64 box of the pixels that show it; NaN for none.
        whole_xyxy: (M, 4) float64 box of all of it as if nothing hid it, cut one image width or height beyond the
            image; NaN if not a single pixel would show it.
        visible_px: (M,) int64 number of pixels that show it.
        occlusion: (M,) float64 share of the pixels that would show it which show something else; NaN for none.
        truncation: (M,) float64 share of the whole box that lies outside the image; NaN for none.
    """

    visible_xyxy: F64
    whole_xyxy: F64
    visible_px: I64
    occlusion: F64
    truncation: F64


def visible_boxes(image: CameraImage) -> F64:
    """(M, 4) left, top, right, bottom of the visible pixels of each mover; NaN for none."""
    boxes = np.full((len(image.alone_px), 4), np.nan)
    for row in np.flatnonzero(image.seen_px):
        left, top, right, bottom = image.alone_xyxy[row].astype(int)
        shown = image.movers[top:bottom, left:right] == row
        columns, rows = np.flatnonzero(shown.any(0)), np.flatnonzero(shown.any(1))
        boxes[row] = left + columns[0], top + rows[0], left + columns[-1] + 1, top + rows[-1] + 1
    return boxes


def visibility(image: CameraImage, camera: Camera, movers: tuple[Mover, ...], time_ns: int) -> Visibility:
    """Visibility of each of a scene's movers (M) in an image, whose exposure has its middle at `time_ns`."""
    whole, to_camera = image.alone_xyxy.copy(), camera.optical_pose(time_ns).inverse()
    for row in np.flatnonzero(image.alone_px):
        box = projected_box(camera.model, to_camera, movers[row].parts, time_ns)
        whole[row, :2] = np.fmin(whole[row, :2], box[:2])
        whole[row, 2:] = np.fmax(whole[row, 2:], box[2:])
    seen = image.seen_px
    size = np.array([camera.model.width_px, camera.model.height_px], np.float64)
    inside = np.concatenate([np.clip(whole[:, :2], 0, size), np.clip(whole[:, 2:], 0, size)], 1)
    shown = image.alone_px > 0
    alone = np.where(shown, image.alone_px, np.nan)
    return Visibility(visible_boxes(image), whole, seen, 1 - seen / alone, 1 - _areas(inside) / _areas(whole))


def projected_box(model: CameraModel, to_camera: Poses, parts: tuple[Part, ...], time_ns: int) -> F64:
    """Left, top, right, bottom (4,) of the projected surface of some parts; NaN if all of it is behind the camera.

    It is cut at `NEAR_M` before the camera, and one image width or height beyond the image. `to_camera` is a single
    transform from the world to the optical frame.
    """
    points = np.concatenate([_ahead(part, to_camera.apply(placed_vertices(part, time_ns))) for part in parts])
    if not len(points):
        return np.full(4, np.nan)
    pixels, valid = model.project(points)
    if not valid.all():  # beyond the lens model, and so beyond the image: only the direction matters
        x, y, z = points[~valid].T
        beyond = np.stack([x / z * model.K[0, 0] + model.K[0, 2], y / z * model.K[1, 1] + model.K[1, 2]], 1)
        pixels[~valid] = beyond
    size = np.array([model.width_px, model.height_px], np.float64)
    pixels = np.clip(pixels, -size, 2 * size)
    return np.concatenate([pixels.min(0), pixels.max(0)])


def _ahead(part: Part, vertices: F64) -> F64:
    """Points (K, 3) around the surface of a part before the camera: its vertices, and the cuts through its edges.

    The vertices (V, 3) are in the optical frame.
    """
    ahead = vertices[:, 2] >= NEAR_M
    if ahead.all():
        return vertices
    start, end = (np.concatenate([part.mesh.triangles[:, edge[side]] for edge in EDGES]) for side in (0, 1))
    cut = ahead[start] != ahead[end]
    start, end = vertices[start[cut]], vertices[end[cut]]
    share = (NEAR_M - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    return np.concatenate([vertices[ahead], start + share * (end - start)])


def _areas(boxes: F64) -> F64:
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))
