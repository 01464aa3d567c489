"""Images of drawn worlds with the true boxes in them, cut into parts that a network learns from."""

from collections.abc import Iterator
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import cv2
import numpy as np

from lidcam.bags.simulator.recorder.stage import Stage
from lidcam.bags.simulator.scenario.scenario import Scenario, SunScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario
from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.sensors.visibility import visible_boxes
from lidcam.bags.simulator.worlds.draw import FAMILIES, Family, random_lidar, random_numbers_of, random_scenario
from lidcam.pipeline.core.arrays import F32, F64, I64, U8, Bools
from lidcam.pipeline.detectors.onnx.layouts.cells import cells_of

CLASSES = ("car", "pedestrian", "cyclist", "truck", "bus")
"""A van counts as a truck, as it does among the classes of lidcam."""

WORLDS_OF_A_ROUND = 6
ROUNDS_OF_A_WORLD = 4
CUTS_OF_A_ROUND = 1200
"""Each round brings new worlds, but cuts also come from the worlds of the last rounds: rendering an image takes as long
as learning from thirty cuts.
"""

IMAGES_OF_A_WORLD = 6
BETWEEN_NS = 300_000_000
"""Time between two images of a world."""

IMAGE_PX = (512, 384)
CUT_PX = (320, 256)
"""Width and height. A convolutional network works with any size."""

MIN_VISIBLE, MIN_HEIGHT_PX = 0.3, 12.0
"""Objects that are less visible, or lower, may be found but need not be, as for scenarios' simulated detectors."""

LIMITS_PX = (64.0, 144.0)
"""The finest grid finds objects with a longer side below the first limit, the coarsest those from the second up."""

SIGMA_CELLS = 0.8
UNSURE, NEAR = 0.9, 0.4
"""Heights of the bells around the middle of an object, see `lidcam.training.pillars.scenes`."""


class Picture(NamedTuple):
    """An image and M objects in it.

    Attributes:
        rgb: (H, W, 3) pixels.
        xyxy: (M, 4) left, top, right, bottom of the pixels that show each object.
        classes: (M,) rows of `CLASSES`.
        is_sure: (M,) whether they have to be found.
    """

    rgb: U8
    xyxy: F64
    classes: I64
    is_sure: Bools


class Cut(NamedTuple):
    """A part of an image as the network takes it, and the output it should give for the A cells.

    Attributes:
        image: (3, H, W) float32 blue, green, red, 0 to 255.
        heat: (A,) float32, 1 in the cell where the middle of an object is.
        cells: (K,) cells that learn a box.
        xyxy: (K, 4) float32 box of each.
        classes: (K,) class of each.
    """

    image: F32
    heat: F32
    cells: I64
    xyxy: F32
    classes: I64


def cuts(seed: int) -> Iterator[Cut]:
    """An endless, reproducible stream of parts of images, of worlds from a number on."""
    for row in count():
        draw, first = np.random.default_rng([seed, row]), seed + max(row + 1 - ROUNDS_OF_A_WORLD, 0) * WORLDS_OF_A_ROUND
        known = [one for world in range(first, seed + (row + 1) * WORLDS_OF_A_ROUND) for one in pictures(world)]
        for _ in range(CUTS_OF_A_ROUND):
            yield learnable(_cut(known[draw.integers(len(known))], draw))


@lru_cache(WORLDS_OF_A_ROUND * ROUNDS_OF_A_WORLD)
def pictures(world: int) -> tuple[Picture, ...]:
    """Images of a world, each from another camera; the families of worlds take turns."""
    return tuple(_pictures(world))


def _pictures(world: int) -> Iterator[Picture]:
    family = FAMILIES[world % len(FAMILIES)]
    scenario = random_scenario(family, world)
    stage = Stage(scenario)
    names = ["truck" if mover.class_name == "van" else mover.class_name for mover in stage.scene.movers]
    classes = np.array([CLASSES.index(name) for name in names], np.int64)
    for number in range(IMAGES_OF_A_WORLD):
        draw, time_ns = random_numbers_of(family, world, number, 3), number * BETWEEN_NS
        stage.traffic.advance(time_ns)
        settings, sun = _camera(family, scenario, draw)
        image = Camera("camera", settings, stage.sensor_path(settings), stage.scene, sun, world).image(number, time_ns)
        boxes = visible_boxes(image)
        seen = np.flatnonzero(image.seen_px)
        is_sure = image.seen_px >= MIN_VISIBLE * image.alone_px
        is_sure[seen] &= boxes[seen, 3] - boxes[seen, 1] >= MIN_HEIGHT_PX
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(draw.integers(60, 96))]
        file = cv2.imencode(".jpg", _painted(image, draw), quality)[1]
        rgb = np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR), np.uint8)
        yield Picture(rgb, boxes[seen], classes[seen], is_sure[seen])


def _painted(image: CameraImage, draw: np.random.Generator) -> U8:
    """An image with stripes and rows of windows behind its objects: drawn worlds have neither markings nor facades."""
    painted = image.rgb.copy()
    for _ in range(draw.integers(0, 7)):
        turn, skew = draw.uniform(0, 2 * np.pi), draw.uniform(0.3, 2.8)
        along, across = np.exp(draw.uniform(np.log(5), np.log(60), 2))
        turns = np.array([turn, turn + skew])
        axes = np.array([[along], [across]]) * np.column_stack([np.cos(turns), np.sin(turns)])
        columns, rows = draw.integers(1, 10), draw.integers(1, 6)
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 1, 2)
        corners = cells + np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * draw.uniform(0.3, 0.7, 2)
        places = draw.uniform(0, 1, 2) * IMAGE_PX + corners @ axes
        grey = draw.uniform(0, 255) if draw.random() < 0.5 else 240.0
        cv2.fillPoly(painted, [*places.astype(np.int32)], (grey + draw.uniform(-40, 15, 3)).clip(0, 255).tolist())
    return np.where(image.movers[..., None] < 0, painted, image.rgb)


def _camera(family: Family, scenario: Scenario, draw: np.random.Generator) -> tuple[CameraScenario, SunScenario]:
    """A camera where a lidar might be, and the sun."""
    place = random_lidar(family, draw, scenario.ground, scenario.things)
    turn_deg, down_deg = (180, 8) if family == "road" else (60, 25)
    focal_px = float(np.exp(draw.uniform(np.log(300), np.log(950))))
    camera = CameraScenario(
        topic="/image", info_topic="/info", frame_id="camera", mounted_on=place.mounted_on, position_m=place.position_m,
        rpy_deg=(draw.normal(0, 2), draw.uniform(-2, down_deg), place.rpy_deg[2] + draw.uniform(-turn_deg, turn_deg)),
        width_px=IMAGE_PX[0], height_px=IMAGE_PX[1], focal_px=(focal_px, focal_px),
        gain=draw.uniform(0.7, 1.3), noise=draw.uniform(0, 2),
    )  # fmt: skip
    return camera, SunScenario(azimuth_deg=draw.uniform(-180, 180), elevation_deg=draw.uniform(20, 75))


def _cut(picture: Picture, draw: np.random.Generator) -> Picture:
    """A part of an image, mostly around an object, randomly mirrored and tinted."""
    size: I64 = np.array(CUT_PX)
    room = np.array(IMAGE_PX) - size
    corner = draw.integers(0, room + 1)
    if len(picture.xyxy) and draw.random() < 0.8:
        box = picture.xyxy[draw.integers(len(picture.xyxy))]
        corner = np.clip((box[:2] + box[2:]) / 2 - draw.uniform(0.1, 0.9, 2) * size, 0, room).astype(np.int64)
    (left, top), (right, bottom) = corner, corner + size
    rgb, whole = picture.rgb[top:bottom, left:right], picture.xyxy - np.tile(corner, 2)
    xyxy = np.clip(whole, 0, np.tile(size, 2))
    shown = _areas(xyxy) / _areas(whole)
    is_sure = picture.is_sure & (shown >= MIN_VISIBLE) & (xyxy[:, 3] - xyxy[:, 1] >= MIN_HEIGHT_PX)
    if draw.random() < 0.5:
        rgb, xyxy = rgb[:, ::-1], xyxy[:, [2, 1, 0, 3]] * [-1, 1, -1, 1] + [size[0], 0, size[0], 0]
    tint = draw.uniform(0.7, 1.3) * draw.uniform(0.9, 1.1, 3)
    kept = shown > 0
    tinted = np.clip(rgb * tint.astype(np.float32), 0, 255).astype(np.uint8)
    return Picture(tinted, xyxy[kept], picture.classes[kept], is_sure[kept])


def learnable(cut: Picture) -> Cut:
    """A part of an image with the output that the network should give for it."""
    column_row, stride_px = (cells.astype(np.float64) for cells in cells_of(cut.rgb.shape[:2]))
    low, high = cut.xyxy[:, :2], cut.xyxy[:, 2:]
    own_px = np.array([8, 16, 32])[np.digitize((high - low).max(1), LIMITS_PX)]
    middle = np.floor((low + high) / 2 / own_px[:, None])
    away = ((column_row[:, None] - middle) ** 2).sum(2)
    bells = np.exp(-0.5 * away / SIGMA_CELLS**2) * (stride_px == own_px)
    heat = (bells * np.where(cut.is_sure, 1.0, UNSURE)).max(1, initial=0.0)
    best = np.column_stack([np.full(len(bells), NEAR), bells * cut.is_sure])
    own = best.argmax(1) - 1
    cells = np.flatnonzero(own >= 0)
    own = own[cells]
    image = np.ascontiguousarray(cut.rgb[..., ::-1].transpose(2, 0, 1), np.float32)
    return Cut(image, heat.astype(np.float32), cells, cut.xyxy[own].astype(np.float32), cut.classes[own])


def _areas(xyxy: F64) -> F64:
    return np.asarray((xyxy[:, 2] - xyxy[:, 0]) * (xyxy[:, 3] - xyxy[:, 1]))
