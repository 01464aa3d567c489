"""Records of a frame as Rerun's archetypes."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import rerun as rr

from lidcam.pipeline.core.arrays import F32, F64, U8, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, source_names
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.drawing import DrawnBoxes2D, DrawnObjects, ObjectEdges, ground_ellipses, labels_in_the_clear
from lidcam.writers.palette import CAMERA_ONLY, GROUND, HEIGHT_COLORS, TRUTH, Rgb, height_rows

Look = Literal["strong", "thin", "faint"]

MAX_POINTS = 100_000
"""Points logged per frame; larger clouds are thinned evenly to keep the viewer responsive."""

_LABEL_SHARE, _LETTER_SHARE = 0.08, 0.02
"""Height of a label as a share of the image's, and width of a letter: in panels of the usual size."""

_RED, _GREEN, _BLUE = HEIGHT_COLORS.T.astype(np.uint32)
_PACKED_COLORS = _RED << 24 | _GREEN << 16 | _BLUE << 8 | 255
"""`HEIGHT_COLORS` as 0xRRGGBBAA."""

_PADDING_SHARE = 0.05
"""Width of a label beside its letters."""

_FACE_ALPHA = 32
_BEHIND_ALPHA = 110
"""Opacity of a 2D box where the 3D box of its object is drawn; of 255, as that of faces."""


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
    """Some of the fused objects.

    Args:
        drawn: All of them.
        rows: (N,) which of them.
        look: `strong`: thick lines; `thin`, `faint`: thin lines.
    """
    objects = drawn.boxes.select(rows)
    return rr.Boxes3D(
        centers=objects.centers,
        sizes=objects.sizes,
        quaternions=_turns(objects.yaws),
        colors=_bytes(drawn.colors[rows]),
        labels=[label for label, chosen in zip(drawn.labels, rows.tolist(), strict=True) if chosen],
        show_labels=False,
        fill_mode="MajorWireframe",
        radii=rr.Radius.ui_points(1.5 if look == "strong" else 0.7),
    )


def faces_3d(drawn: DrawnObjects, rows: Bools) -> rr.Boxes3D:
    """The faces of some of the fused objects, so faint that the points in a large one are seen through them."""
    objects = drawn.boxes.select(rows)
    rgb = _bytes(drawn.colors[rows])
    return rr.Boxes3D(
        centers=objects.centers,
        sizes=objects.sizes,
        quaternions=_turns(objects.yaws),
        colors=np.column_stack([rgb, np.full(len(rgb), _FACE_ALPHA, np.uint8)]),
        fill_mode="Solid",
    )


def object_texts(drawn: DrawnObjects, texts: Sequence[str], places: F64, rows: Bools) -> rr.Points3D:
    """Texts (N,) at places (N, 3) of some of the fused objects, which never wrap and have no point."""
    return rr.Points3D(
        places[rows],
        colors=_bytes(drawn.colors[rows]),
        radii=0.0,
        labels=[text for text, chosen in zip(texts, rows.tolist(), strict=True) if chosen],
        show_labels=True,
    )


def label_lines(drawn: DrawnObjects, places: F64, rows: Bools) -> rr.LineStrips3D:
    """Lines from the roofs of some of the fused objects to their labels, where these are raised."""
    tops = drawn.roofs
    rows = rows & (places[:, 2] != tops[:, 2])
    lines = np.stack([tops, places], 1)[rows].astype(np.float32)
    return rr.LineStrips3D(lines, colors=_bytes(drawn.colors[rows]), radii=rr.Radius.ui_points(0.4))


def object_facts(drawn: DrawnObjects, rows: Bools) -> rr.DynamicArchetype:
    """Sources of the geometry of some of the fused objects, and what their tracks say, to be read in the viewer."""
    tracks, sources = drawn.result.fused.tracks, source_names(drawn.boxes.sources[rows])
    facts: dict[str, Any] = {"source": rr.components.TextBatch(sources)}
    if tracks is not None:
        chosen = tracks.select(rows)
        columns = {"track": chosen.ids, "speed_m_s": chosen.speeds}
        columns |= {"existence": chosen.existence, "age_s": chosen.ages_s}
        facts |= {name: pa.array(column) for name, column in columns.items()}  # empty ones have their type, too
    return rr.DynamicArchetype("lidcam.Objects", drop_untyped_nones=False, components=facts)


def trails(drawn: DrawnObjects, paths: Sequence[F64]) -> rr.LineStrips3D:
    """The trails of the fused objects that have one, in their colours."""
    rows = [row for row, path in enumerate(paths) if len(path)]
    return rr.LineStrips3D(
        [paths[row] for row in rows],
        colors=_bytes(drawn.colors[rows]),
        radii=rr.Radius.ui_points(1.6),
    )


def object_ellipses(drawn: DrawnObjects, rows: Bools) -> rr.LineStrips3D:
    """An ellipse of one standard deviation on the ground, around some of the fused objects."""
    objects = drawn.boxes.select(rows)
    return _ellipses(objects, _bytes(drawn.colors[rows]))


def placed_boxes(boxes: Boxes3D, class_names: Sequence[str]) -> rr.Boxes3D:
    """Boxes that the cameras alone place: edges, with class and score to be read in the viewer."""
    columns = zip(boxes.class_ids.tolist(), boxes.scores.tolist(), strict=True)
    return _edges(boxes, [f"{class_names[class_id]} {score:.2f}" for class_id, score in columns], CAMERA_ONLY, 0.7)


def placed_ellipses(boxes: Boxes3D) -> rr.LineStrips3D:
    """Ellipses of one standard deviation of their places."""
    return _ellipses(boxes, np.tile(np.array(CAMERA_ONLY.bytes_rgb, np.uint8), (len(boxes), 1)))


def _ellipses(boxes: Boxes3D, colors: U8) -> rr.LineStrips3D:
    points = ground_ellipses(boxes)
    closed = np.concatenate([points, points[:, :1]], 1)
    return rr.LineStrips3D(closed, colors=colors, radii=rr.Radius.ui_points(0.7))


def _turns(yaws: F64) -> F64:
    """(N, 4) quaternions x, y, z, w."""
    zeros = np.zeros_like(yaws)
    return np.stack([zeros, zeros, np.sin(yaws / 2), np.cos(yaws / 2)], -1)


def truth_boxes(truth: TrueBoxes) -> rr.Boxes3D:
    """Objects of the truth: their edges and classes."""
    return _edges(truth, [*truth.labels], TRUTH, 1.0)


def _edges(boxes: Boxes3D | TrueBoxes, labels: Sequence[str], color: Rgb, radius: float) -> rr.Boxes3D:
    """The edges of boxes, with labels to be read in the viewer."""
    return rr.Boxes3D(
        centers=boxes.centers,
        sizes=boxes.sizes,
        quaternions=_turns(boxes.yaws),
        colors=color.bytes_rgb,
        labels=labels,
        show_labels=False,
        fill_mode="MajorWireframe",
        radii=rr.Radius.ui_points(radius),
    )


def heading_arrows(drawn: DrawnObjects, rows: Bools) -> rr.Arrows3D:
    """Arrows along the headings of some of the fused objects, where their fronts are known."""
    lengths = drawn.arrow_lengths_m
    rows = rows & (lengths > 0)
    objects = drawn.boxes.select(rows)
    ahead = np.stack([np.cos(objects.yaws), np.sin(objects.yaws), np.zeros_like(objects.yaws)], -1)
    return rr.Arrows3D(
        origins=objects.centers,
        vectors=ahead * lengths[rows, None],
        colors=_bytes(drawn.colors[rows]),
        radii=objects.sizes[:, 2] * 0.03,
    )


def edges_2d(drawn: DrawnObjects, edges: ObjectEdges) -> rr.LineStrips2D:
    """The fused objects as the camera's lens bends them: thinner where faint, or where no lidar shows them."""
    segments, rows = edges
    is_thick = drawn.strong & ~drawn.thin
    radii = np.where(is_thick, -1.0, -0.5)[rows]  # Rerun: a negative radius is in points of the screen
    return rr.LineStrips2D(segments, colors=_bytes(drawn.colors[rows]), radii=radii, draw_order=20.0)


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


def labels_2d(drawn: DrawnBoxes2D, camera: CameraSensor) -> rr.Points2D:
    """The labels of 2D boxes, below each: Rerun wraps a box's own label to the width of the box, a point's never.

    A label that would cover that of a larger box is left out, and so is that of a box that is lower than a label.
    """
    size_px = np.array([camera.model.width_px, camera.model.height_px], np.float64)
    low, high = drawn.xyxy[:, :2].astype(np.float64), drawn.xyxy[:, 2:].astype(np.float64)
    widths = [len(label) * _LETTER_SHARE + _PADDING_SHARE for label in drawn.labels]
    sizes = np.stack([widths, np.full(len(low), _LABEL_SHARE)], -1)
    sizes *= size_px
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


def _bytes(colors: F64) -> U8:
    return np.round(colors * 255).astype(np.uint8)


def _thinned(xyz: F32, combined: CombinedCloud) -> F32:
    """Points of a frame, evenly spaced, so that the frame has no more than `MAX_POINTS`."""
    total = len(combined.cloud) + len(combined.ground_cloud)
    if total <= MAX_POINTS:
        return xyz
    return xyz[np.linspace(0, len(xyz) - 1, int(len(xyz) * MAX_POINTS / total)).astype(np.intp)]
