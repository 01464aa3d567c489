"""Records of a frame as Rerun's archetypes."""

from collections.abc import Sequence
from itertools import compress
from typing import Any, Literal

import numpy as np
import rerun as rr

from lidcam.pipeline.core.arrays import F32, F64, U8, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, source_names
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.drawing import DrawnBoxes2D, DrawnObjects, ObjectEdges, ground_ellipses, labels_in_the_clear
from lidcam.writers.palette import CAMERA_ONLY, GROUND, HEIGHT_COLORS, TRUTH, height_rows

Look = Literal["strong", "thin"]
"""`strong`: thick lines and faint faces; `thin`: thin lines, of objects that are faint or shown by no lidar."""

LINE_POINTS: dict[Look, float] = {"strong": 1.5, "thin": 0.7}
"""Half the width of lines on the screen."""

FILL: dict[Look, Any] = {"strong": "TransparentFillMajorWireframe", "thin": "MajorWireframe"}

LEGEND_STEP = 0.2
"""Distance of the lines of the legend, as a share of the width of a column."""

MAX_POINTS = 100_000
"""Points logged per frame; larger clouds are thinned evenly to keep the viewer responsive."""

_LABEL_POINTS, _LETTER_POINTS, _PADDING_POINTS = 28.0, 7.5, 16.0
"""Height of a label in an image, width of a letter, and width beside the letters, in points of the screen."""

_RED, _GREEN, _BLUE = HEIGHT_COLORS.T.astype(np.uint32)
_PACKED_COLORS = _RED << 24 | _GREEN << 16 | _BLUE << 8 | 255
"""`HEIGHT_COLORS` as 0xRRGGBBAA."""

_BEHIND_ALPHA = 110
"""Opacity of a 2D box where the 3D box of its object is drawn; of 255."""

_OWN_SIZE_M = np.array([4.5, 1.8, 1.5])
"""Length, width and height of an ordinary car: no recording says how large the vehicle is that carries the sensors."""

OWN_VEHICLE, WAY = (190, 195, 205), (225, 190, 90)
"""Colours of the vehicle that carries the sensors, and of its path."""


def cloud_points(combined: CombinedCloud, heights: tuple[float, float]) -> rr.Points3D:
    """The points above the ground, coloured by height."""
    xyz = _thinned(combined.cloud.xyz, combined)
    colors = _PACKED_COLORS[height_rows(xyz[:, 2], heights)]
    return rr.Points3D(xyz, colors=colors, radii=rr.Radius.ui_points(1.3))


def ground_points(combined: CombinedCloud) -> rr.Points3D:
    """The points of the ground."""
    xyz = _thinned(combined.ground_cloud.xyz, combined)
    return rr.Points3D(xyz, colors=GROUND, radii=rr.Radius.ui_points(0.9))


def objects_3d(drawn: DrawnObjects, rows: Bools, look: Look) -> rr.Boxes3D:
    """Those of the fused objects that a mask (N,) chooses."""
    objects, labels = drawn.boxes.select(rows), [*compress(drawn.labels, rows)]
    return _boxes(objects.centers, objects.sizes, objects.yaws, bytes_of(drawn.colors[rows]), labels, look)


def _boxes(
    centers: Any, sizes: Any, yaws: F64, colors: Any, labels: Any, look: Look, points: float | None = None
) -> rr.Boxes3D:
    """Boxes in the lines of a look, unless others are wanted, with labels to be read in the viewer."""
    return rr.Boxes3D(
        centers=centers,
        sizes=sizes,
        quaternions=turns_of(yaws),
        colors=colors,
        labels=labels,
        show_labels=False,
        fill_mode=FILL[look],
        radii=rr.Radius.ui_points(LINE_POINTS[look] if points is None else points),
    )


def own_vehicle(middle: F64, front: F64) -> rr.Boxes3D:
    """The vehicle that carries the sensors, about as large as a car.

    Args:
        middle: (3,) on the ground, below the middle of the sensors, metres.
        front: (2,) unit vector in which it drives.
    """
    center, yaw = middle + _OWN_SIZE_M * [0.0, 0.0, 0.5], np.arctan2(front[1:], front[:1])
    return _boxes([center], [_OWN_SIZE_M], yaw, OWN_VEHICLE, "own vehicle", "strong", 1.0)


def legend(named: Sequence[tuple[str, tuple[int, int, int]]], first: int) -> rr.Points2D:
    """Colours and what has them, in two columns, from place `first` on: place 0 is at the top left, 1 beside it."""
    rows = first + np.arange(len(named))
    names, colors = zip(*named, strict=True)
    places = np.stack([rows % 2 + 0.5, rows // 2 * LEGEND_STEP], 1)
    return rr.Points2D(places, colors=colors, labels=names, radii=0.0, show_labels=True)


def object_texts(drawn: DrawnObjects, texts: Sequence[str], places: F64, rows: Bools) -> rr.Points3D:
    """Texts (N,) at places (N, 3) of some of the fused objects, which never wrap and have no point."""
    colors, labels = bytes_of(drawn.colors[rows]), [*compress(texts, rows)]
    return rr.Points3D(places[rows], colors=colors, radii=0.0, labels=labels, show_labels=True)


def label_lines(drawn: DrawnObjects, places: F64, rows: Bools) -> rr.LineStrips3D:
    """Lines from the roofs of some of the fused objects to their labels, where these are raised."""
    tops = drawn.roofs
    rows = rows & (places[:, 2] != tops[:, 2])
    lines = np.stack([tops, places], 1)[rows].astype(np.float32)
    return rr.LineStrips3D(lines, colors=bytes_of(drawn.colors[rows]), radii=rr.Radius.ui_points(0.4))


def object_facts(drawn: DrawnObjects, rows: Bools) -> rr.DynamicArchetype:
    """Sources of the geometry of some of the fused objects, to be read in the viewer."""
    sources = rr.components.TextBatch(source_names(drawn.boxes.sources[rows]))
    return rr.DynamicArchetype("lidcam.Objects", components={"source": sources})


def trails(drawn: DrawnObjects, paths: Sequence[F64]) -> rr.LineStrips3D:
    """The trails of the fused objects that have one, in their colours."""
    rows = [row for row, path in enumerate(paths) if len(path)]
    colors, radius = bytes_of(drawn.colors[rows]), rr.Radius.ui_points(1.6)
    return rr.LineStrips3D([paths[row] for row in rows], colors=colors, radii=radius)


def placed_boxes(boxes: Boxes3D, class_names: Sequence[str]) -> rr.Boxes3D:
    """Boxes that the cameras alone place: edges, with class and score to be read in the viewer."""
    columns = zip(boxes.class_ids.tolist(), boxes.scores.tolist(), strict=True)
    labels = [f"{class_names[class_id]} {score:.2f}" for class_id, score in columns]
    return _boxes(boxes.centers, boxes.sizes, boxes.yaws, CAMERA_ONLY.bytes_rgb, labels, "thin")


def ellipses(boxes: Boxes3D, colors: F64) -> rr.LineStrips3D:
    """Ellipses on the ground, of one standard deviation, around boxes, in colours (N, 3) in [0, 1]."""
    points = ground_ellipses(boxes)
    closed = np.concatenate([points, points[:, :1]], 1)
    return rr.LineStrips3D(closed, colors=bytes_of(colors), radii=rr.Radius.ui_points(0.7))


def turns_of(yaws: F64) -> F64:
    """(N, 4) quaternions x, y, z, w."""
    zeros = np.zeros_like(yaws)
    return np.stack([zeros, zeros, np.sin(yaws / 2), np.cos(yaws / 2)], -1)


def truth_boxes(truth: TrueBoxes) -> rr.Boxes3D:
    """Objects of the truth: their edges and classes."""
    return _boxes(truth.centers, truth.sizes, truth.yaws, TRUTH.bytes_rgb, [*truth.labels], "thin", 1.0)


def heading_arrows(drawn: DrawnObjects, rows: Bools) -> rr.Arrows3D:
    """Arrows along the headings of some of the fused objects, where their fronts are known."""
    lengths = drawn.arrow_lengths_m
    rows = rows & (lengths > 0)
    objects = drawn.boxes.select(rows)
    ahead = np.stack([np.cos(objects.yaws), np.sin(objects.yaws), np.zeros_like(objects.yaws)], -1)
    return rr.Arrows3D(
        origins=objects.centers,
        vectors=ahead * lengths[rows, None],
        colors=bytes_of(drawn.colors[rows]),
        radii=objects.sizes[:, 2] * 0.03,
    )


def edges_2d(drawn: DrawnObjects, edges: ObjectEdges) -> rr.LineStrips2D:
    """The fused objects as the camera's lens bends them: thinner where faint, or where no lidar shows them."""
    segments, rows = edges
    is_thick = drawn.strong & ~drawn.thin
    radii = np.where(is_thick, -1.0, -0.5)[rows]  # Rerun: a negative radius is in points of the screen
    return rr.LineStrips2D(segments, colors=bytes_of(drawn.colors[rows]), radii=radii, draw_order=20.0)


def boxes_2d(drawn: DrawnBoxes2D) -> rr.Boxes2D:
    """A camera's 2D boxes."""
    matched = drawn.are_matched
    alphas = np.where(matched, _BEHIND_ALPHA, 255)
    return rr.Boxes2D(
        array=drawn.xyxy.reshape(-1, 4),
        array_format=rr.Box2DFormat.XYXY,
        colors=[(*color.bytes_rgb, alpha) for color, alpha in zip(drawn.colors, alphas.tolist(), strict=True)],
        radii=np.where(matched, -0.6, -1.2),  # in points of the screen
        labels=drawn.labels,
        show_labels=False,
    )


def labels_2d(drawn: DrawnBoxes2D, camera: CameraSensor, width_points: float) -> rr.Points2D:
    """The labels of boxes in an image, below each: Rerun wraps a box's own label to its width, a point's never.

    A label that would cover that of a larger box is left out, and so is that of a box that is lower than a label, where
    the image is this wide on the screen.
    """
    size_px = np.array([camera.model.width_px, camera.model.height_px], np.float64)
    low, high = drawn.xyxy[:, :2].astype(np.float64), drawn.xyxy[:, 2:].astype(np.float64)
    widths = [len(label) * _LETTER_POINTS + _PADDING_POINTS for label in drawn.labels]
    sizes = np.stack([widths, np.full(len(low), _LABEL_POINTS)], -1) * (camera.model.width_px / width_points)
    places = np.stack([(low[:, 0] + high[:, 0]) / 2, high[:, 1] + sizes[:, 1] / 2], -1)
    places = np.clip(places, sizes / 2, size_px - sizes / 2)
    heights = high[:, 1] - low[:, 1]
    rows = [row for row in labels_in_the_clear(places, sizes, heights) if heights[row] >= sizes[row, 1] / 2]
    return rr.Points2D(
        places[rows] - [0.0, 0.5] * sizes[rows],  # the viewer hangs a label below its point
        colors=[drawn.colors[row].bytes_rgb for row in rows],
        radii=0.0,
        labels=[drawn.labels[row] for row in rows],
        show_labels=True,
    )


def bytes_of(colors: F64) -> U8:
    """(N, 3) colours from 0 to 255."""
    return np.round(colors * 255).astype(np.uint8)


def _thinned(xyz: F32, combined: CombinedCloud) -> F32:
    """Points of a frame, evenly spaced, so that the frame has no more than `MAX_POINTS`."""
    total = len(combined.cloud) + len(combined.ground_cloud)
    if total <= MAX_POINTS:
        return xyz
    return xyz[np.linspace(0, len(xyz) - 1, int(len(xyz) * MAX_POINTS / total)).astype(np.intp)]
