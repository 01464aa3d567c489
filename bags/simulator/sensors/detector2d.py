"""A simulated 2D detector with the errors of a network, to try fusion without weights."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.bags.simulator.scenario.sensors import Detector2DScenario
from lidcam.bags.simulator.sensors.camera import CameraImage
from lidcam.bags.simulator.sensors.timing import random_numbers
from lidcam.bags.simulator.sensors.visibility import visible_boxes
from lidcam.pipeline.core.arrays import F64, I64, Table

NO_MOVER = -1
"""Mover row of a false box."""
SURE_HEIGHT_PX = 40.0
"""Below this box height scores drop."""
FALSE_SCORES = (0.25, 0.55)
FALSE_HEIGHT = (0.05, 0.30)
"""Range of the height of false boxes, as shares of the image height."""


@dataclass(frozen=True, slots=True, eq=False)
class Detected(Table):
    """Detections in one image, those of movers first, in the order of the movers.

    Attributes:
        xyxy: (N, 4) float64 left, top, right, bottom in pixels, counted from the image's corner.
        scores: (N,) float64 in [0, 1].
        class_names: N classes.
        movers: (N,) int64 rows of the detected movers; -1 for a false box.
    """

    xyxy: F64
    scores: F64
    class_names: tuple[str, ...]
    movers: I64


def detect(
    scenario: Detector2DScenario,
    image: CameraImage,
    class_names: Sequence[str],
    *,
    name: str,
    number: int,
    seed: int,
) -> Detected:
    """The detections in an image.

    Each mover has its own random numbers, whatever else the image shows: equal seeds, names of cameras and numbers of
    images give equal boxes. There is a class name for each mover of the scene (M).
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
    found_boxes = _inside(boxes[rows] + scenario.pixel_noise_px * edges[rows], image)
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
