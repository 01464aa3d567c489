"""Movers in an image: the clean 2D truth, and a simulated 2D detector with the errors of a network."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from lidcam.bags.simulator.scenario.sensors import Detector2DScenario
from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.bags.simulator.world.motion import Mover, Part, Poses, placed_vertices
from lidcam.pipeline.core.arrays import F64, I64, Table
from lidcam.pipeline.core.camera import NEAR_M, CameraModel

NO_MOVER = -1  # row of a false box
SURE_HEIGHT_PX = 40.0  # box height below which scores drop
FALSE_SCORES = (0.25, 0.55)
FALSE_HEIGHT = (0.05, 0.30)  # of false boxes, as shares of the image height


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Visibility of each of M movers in an image.

    Boxes are left, top, right, bottom in pixels, counted from the image's corner.
    """

    visible_xyxy: F64  # (M, 4) box of the pixels that show it; NaN for none
    whole_xyxy: F64  # (M, 4) box of all of it, cut one image beyond the border; NaN if no pixel would show it
    visible_px: I64  # (M,) number of pixels that show it
    occlusion: F64  # (M,) share of the pixels that would show it which show something else; NaN for none
    truncation: F64  # (M,) share of the whole box that lies outside the image; NaN for none


def visible_boxes(image: CameraImage) -> F64:
    """(M, 4) left, top, right, bottom of the visible pixels of each mover; NaN for none."""
    boxes = np.full((len(image.alone_px), 4), np.nan)
    for row in np.flatnonzero(image.seen_px):
        left, top, right, bottom = image.alone_xyxy[row].astype(int)
        x, y, width, height = cv2.boundingRect((image.movers[top:bottom, left:right] == row).astype(np.uint8))
        boxes[row] = left + x, top + y, left + x + width, top + y + height
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
        pixels[~valid] = np.c_[x / z * model.K[0, 0] + model.K[0, 2], y / z * model.K[1, 1] + model.K[1, 2]]
    size = np.array([model.width_px, model.height_px], np.float64)
    pixels = np.clip(pixels, -size, 2 * size)
    return np.concatenate([pixels.min(0), pixels.max(0)])


def _ahead(part: Part, vertices: F64) -> F64:
    """The vertices (V, 3), in the optical frame, before the camera, and the cuts through its edges."""
    ahead = vertices[:, 2] >= NEAR_M
    if ahead.all():
        return vertices
    triangles = part.mesh.triangles
    start, end = triangles.T.reshape(-1), np.roll(triangles, -1, axis=1).T.reshape(-1)
    cut = ahead[start] != ahead[end]
    start, end = vertices[start[cut]], vertices[end[cut]]
    share = (NEAR_M - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    return np.concatenate([vertices[ahead], start + share * (end - start)])


def _areas(boxes: F64) -> F64:
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))


@dataclass(frozen=True, slots=True, eq=False)
class Detected(Table):
    """Detections in one image, those of movers first, in the order of the movers."""

    xyxy: F64  # (N, 4) left, top, right, bottom in pixels, from the image's corner
    scores: F64  # (N,) in [0, 1]
    class_names: tuple[str, ...]
    movers: I64  # (N,) rows of the detected movers; `NO_MOVER` for a false box


def detect(
    scenario: Detector2DScenario, image: CameraImage, class_names: Sequence[str], *, name: str, number: int, seed: int
) -> Detected:
    """The detections in an image of movers with these classes (M).

    Each mover has its own random numbers, whatever else the image shows: equal seeds, names of cameras and numbers of
    images give equal boxes.
    """
    count = len(class_names)
    random = random_numbers(seed, name, "detector", number)
    luck, edges, spread = random.random(count), random.standard_normal((count, 4)), random.standard_normal(count)
    boxes = visible_boxes(image)
    visible = image.seen_px / np.maximum(image.alone_px, 1)
    height = np.nan_to_num(boxes[:, 3] - boxes[:, 1])
    found = (image.seen_px > 0) & (visible >= scenario.min_visible) & (height >= scenario.min_height_px)
    found &= luck >= scenario.miss_rate
    rows = np.flatnonzero(found).tolist()
    scores = 0.94 - 0.35 * np.exp(-height / SURE_HEIGHT_PX) - 0.35 * (1 - visible) + 0.04 * spread
    false_boxes, false_scores, false_names = _false_boxes(scenario, image, class_names, name, number, seed)
    outward = np.tile(boxes[:, 2:] - boxes[:, :2], 2) * (-1, -1, 1, 1)
    edges = scenario.edge_bias * outward + scenario.pixel_noise_px * edges
    found_boxes = _inside(boxes[rows] + edges[rows], image)
    return Detected(
        np.concatenate([found_boxes, false_boxes]),
        np.clip(np.concatenate([scores[rows], false_scores]), 0.05, 0.99),
        (*(class_names[row] for row in rows), *false_names),
        np.concatenate([rows, np.full(len(false_names), NO_MOVER)]).astype(np.int64),
    )


def _false_boxes(
    scenario: Detector2DScenario, image: CameraImage, class_names: Sequence[str], name: str, number: int, seed: int
) -> tuple[F64, F64, list[str]]:
    """False boxes in the lower two thirds of the image, with scores and classes."""
    random = random_numbers(seed, name, "false detections", number)
    known = sorted(set(class_names)) or ["car"]
    count = int(random.poisson(scenario.false_per_image))
    rows, columns = image.movers.shape
    height = rows * random.uniform(*FALSE_HEIGHT, count)
    width = height * random.uniform(0.5, 2.0, count)
    left, top = random.uniform(0, 0.9 * columns, count), random.uniform(rows / 3, 0.9 * rows, count)
    names = [known[int(choice)] for choice in random.integers(0, len(known), count)]
    boxes = np.stack([left, top, left + width, top + height], 1)
    return _inside(boxes, image), random.uniform(*FALSE_SCORES, count), names


def _inside(boxes: F64, image: CameraImage) -> F64:
    """Boxes clipped to the image, at least one pixel wide and high."""
    rows, columns = image.movers.shape
    limit = np.array([columns, rows], np.float64)
    low = np.clip(boxes[:, :2], 0, limit - 1)
    return np.concatenate([low, np.clip(np.maximum(boxes[:, 2:], low + 1), 1, limit)], 1)
