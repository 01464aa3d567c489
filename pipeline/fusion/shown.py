"""The objects of a frame as 2D boxes in one image: what people would draw to teach a detector of images."""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import numpy as np

from lidcam.pipeline.core.arrays import F32, I32, I64, U8, Bools, CheckedTable, join_rows
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.geometry.boxes import iou_xyxy
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.assignment import assign
from lidcam.pipeline.fusion.matching.in_view import hidden_parts, project_into_views
from lidcam.pipeline.fusion.projection import CameraArrays, project_edges, rounded_outline

MIN_IOU = 0.4
"""Minimum overlap of a projected object and the 2D box that shows it: 3D boxes are some 10 % too large in images."""

MIN_VISIBLE = 0.5
"""Minimum share of a projected object that no nearer object covers: with less, people would not label it."""

MIN_SCORE = 0.5
"""Minimum score of a 2D box that belongs to no object: below, most are wrong."""

MIN_SIDE_PX = 2.0
"""Minimum width and height of a box."""

NO_TRACK = -1


class Origin(IntEnum):
    """Where a box in an image comes from."""

    BOTH = 0
    """A 2D box of the camera, which an object explains."""
    OBJECT = 1
    """An object, projected: the camera's detector missed it."""
    CAMERA = 2
    """A 2D box of the camera without an object, such as beyond the range of the lidars."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownBoxes(CheckedTable):
    """N boxes in one image."""

    ROWS: ClassVar = {"xyxy": (4,)}

    xyxy: F32  # (N, 4) float32 left, top, right, bottom in pixels, within the image
    class_ids: I32  # (N,) int32, row of the configured classes
    scores: F32  # (N,) float32 in [0, 1], of the object, or of the 2D box where there is none
    track_ids: I64  # (N,) int64, the same for the same object in all images; `NO_TRACK` without
    origins: U8  # (N,) uint8, the `Origin` of each


def shown_boxes(
    objects: Boxes3D, track_ids: I64, is_predicted: Bools, view: CameraSensor, found: Boxes2D | None
) -> ShownBoxes:
    """The boxes of what one image shows.

    An object has the 2D box that overlaps with its projection, which fits more tightly, else the projection itself if
    half of it or more is free and something shows it in this frame. 2D boxes without an object follow.

    Args:
        objects: N fused objects, where they are at the time of the image.
        track_ids: (N,) their tracks.
        is_predicted: (N,) whether nothing shows them in this frame.
        view: The camera where it stood then.
        found: Its 2D boxes; None if it has no detector.
    """
    arrays = CameraArrays.of([view])
    seen = project_into_views(objects, [view], arrays)
    hidden, _, _ = hidden_parts(objects, seen, arrays.positions)
    xyxy, rows = _rounded(objects, seen.rows, arrays, seen.xyxy), seen.rows
    found = Boxes2D.empty(objects.stamp_ns, "") if found is None else found
    limits = arrays.limits[0].astype(np.float32)
    drawn = np.clip(found.xyxy, 0, limits)
    overlaps = iou_xyxy(xyxy, drawn)
    first, second = assign(np.where(overlaps >= MIN_IOU, -overlaps, 0.0))
    is_pair = overlaps[first, second] >= MIN_IOU
    first, second = first[is_pair], second[is_pair]
    xyxy[first] = drawn[second]
    origins = np.full(len(rows), Origin.OBJECT, np.uint8)
    origins[first] = Origin.BOTH
    is_drawn = (origins == Origin.BOTH) | ((hidden <= 1 - MIN_VISIBLE) & ~is_predicted[rows])
    of_objects = ShownBoxes(xyxy, objects.class_ids[rows], objects.scores[rows], track_ids[rows], origins).select(
        is_drawn
    )
    is_alone = found.scores >= MIN_SCORE
    is_alone &= ~(iou_xyxy(drawn, of_objects.xyxy) >= MIN_IOU).any(1)
    count = int(is_alone.sum())
    alone = ShownBoxes(
        drawn[is_alone],
        found.class_ids[is_alone],
        found.scores[is_alone],
        np.full(count, NO_TRACK, np.int64),
        np.full(count, Origin.CAMERA, np.uint8),
    )
    shown = join_rows(of_objects, alone)
    sides = shown.xyxy[:, 2:] - shown.xyxy[:, :2]
    return shown.select(np.flatnonzero((sides >= MIN_SIDE_PX).all(1)))


def _rounded(objects: Boxes3D, rows: I64, arrays: CameraArrays, xyxy: F32) -> F32:
    """(P, 4) rectangles around objects with round corners; those of their boxes beside the camera."""
    cameras = arrays.select(np.zeros(len(rows), np.int64))
    sizes = objects.sizes[rows]
    outline = rounded_outline(sizes, bent=cameras.lenses.bends)
    edges = project_edges(objects.centers[rows], sizes, objects.yaws[rows], cameras, outline)
    return np.where(edges.valid[:, None], edges.xyxy.clip(0.0, cameras.limits), xyxy).astype(np.float32)
