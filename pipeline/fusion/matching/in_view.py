"""The 3D boxes of a frame in the images of all cameras at once, and their mutual occlusion.

A line along a side of one of them separates two boxes on the ground that do not overlap, and the one on the camera's
side is in front. That is exact for boxes, where a comparison of distances is wrong beside long ones (a bus along the
road, and a pedestrian beside its middle).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Indices, Table, first_of_runs, pairs_of_equal
from lidcam.pipeline.core.camera import NEAR_M
from lidcam.pipeline.core.detections import Boxes3D
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.optics.lenses import may_show
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.projection import CameraArrays, cuboid_outline, project_edges

MAX_COVERS = 8
"""Maximum number of boxes in front of one, those that cover most of it."""

MIN_EDGE_SHARE = 0.5
"""Minimum share of an edge that a nearer box covers for the edge to count as hidden."""

EDGE_REACH = 0.1
"""Distance from an edge within which a nearer box reaches it, as a share of the rectangle."""


@dataclass(frozen=True, slots=True, eq=False)
class InView(Table):
    """The P pairs of a camera and a box that it sees in part, ordered by camera, then by box."""

    cameras: I64  # (P,) int64 number of the camera
    rows: I64  # (P,) int64 row of the box
    xyxy: F32  # (P, 4) float32 left, top, right, bottom of what the image shows, pixels
    # (P, 4, 3) float64, derivatives of the edges of the whole box by its x, y (metres) and yaw (radians); zero where an
    # edge is the border of the image, or the box reaches behind the camera
    jacobian: F64
    ranges_m: F64  # (P,) float64 distance of the box's centre from the camera


def project_into_views(boxes: Boxes3D, views: Sequence[CameraSensor], arrays: CameraArrays) -> InView:
    """The rectangles of all boxes in all images.

    Args:
        boxes: N boxes in the site frame.
        views: The cameras.
        arrays: The same cameras as arrays.

    Raises:
        FrameError: the boxes are not in the site frame of the cameras.
    """
    for view in views:
        if view.T_camera_site.src != boxes.frame_id:
            raise FrameError(
                f"camera {view.name}: expected boxes in frame {view.T_camera_site.src!r}, found {boxes.frame_id!r}"
            )
    centers_camera = boxes.centers @ arrays.rotations.swapaxes(1, 2) + arrays.translations[:, None]
    radii_m = np.sqrt((boxes.sizes**2).sum(1)) / 2
    if arrays.lenses.bends:
        near = may_show([view.model for view in views], centers_camera, radii_m)
    else:
        near = _in_pyramids(centers_camera, radii_m, arrays)
    cameras, rows = (np.ascontiguousarray(pairs) for pairs in near.nonzero())
    placed = boxes.centers.take(rows, 0), boxes.sizes.take(rows, 0), boxes.yaws.take(rows)
    outline = cuboid_outline(bent=bool(arrays.lenses.bent[cameras].any()))
    edges = project_edges(*placed, arrays, outline, rows=cameras)
    xyxy, limits = edges.xyxy.copy(), arrays.limits[cameras]
    cut = np.flatnonzero(~edges.valid | ((xyxy < 0.0) | (xyxy > limits)).any(1))
    if len(cut):  # by the border, or beside the camera
        xyxy[cut] = _cut_rectangles(box_corners(*(array[cut] for array in placed)), arrays.select(cameras[cut]))
    moves = (xyxy > 0.0) & (xyxy < limits) & edges.valid[:, None]
    jacobian = edges.jacobian[..., :3] * moves[..., None]
    ranges_m = np.sqrt((centers_camera[cameras, rows] ** 2).sum(1))
    seen = InView(cameras, rows, xyxy.astype(np.float32), jacobian, ranges_m)
    shown = (xyxy[:, 2] > xyxy[:, 0]) & (xyxy[:, 3] > xyxy[:, 1])
    return seen if shown.all() else seen.select(shown)


def hidden_parts(boxes: Boxes3D, seen: InView, positions_site: F64) -> tuple[F32, F32, F32]:
    """The parts of P rectangles covered by boxes in front of them.

    Args:
        boxes: N boxes in the site frame.
        seen: P of them in images.
        positions_site: (C, 3) positions of the cameras, metres.

    Returns:
        (P,) covered share of the rectangle; (P, 4) the smallest rectangle around the rest, in pixels, or the rectangle
        itself if nothing is left; (P, 4) how deep a nearer box covers each edge, pixels inward, 0 for free edges.
    """
    share, rest, depths = np.zeros(len(seen), np.float32), seen.xyxy.copy(), np.zeros((len(seen), 4), np.float32)
    back, front = pairs_of_equal(seen.cameras, seen.cameras)
    shared = _intersections(seen.xyxy[back], seen.xyxy[front])
    overlap = np.flatnonzero((back != front) & (shared[:, 2] > shared[:, 0]) & (shared[:, 3] > shared[:, 1]))
    back, front, shared = back[overlap], front[overlap], shared[overlap]
    in_front = np.flatnonzero(_in_front(boxes, seen, positions_site, front, back))
    back, shared = back[in_front], shared[in_front]
    if not len(back):
        return share, rest, depths
    np.maximum.at(depths, back, _edge_depths(seen.xyxy[back].astype(np.float64), shared))
    order = np.lexsort([-(shared[:, 2:] - shared[:, :2]).prod(1), back])
    back, shared = back[order], shared[order]
    is_first = first_of_runs(back)
    group = np.cumsum(is_first) - 1
    rank = np.arange(len(back)) - np.flatnonzero(is_first)[group]
    counted = rank < MAX_COVERS
    hidden = back[is_first]
    whole = seen.xyxy[hidden].astype(np.float64)
    covers = whole[:, None, [0, 1, 0, 1]].repeat(int(rank[counted].max()) + 1, 1)  # without extent, but for
    covers[group[counted], rank[counted]] = shared[counted]
    share[hidden], rest[hidden] = _uncovered(whole, covers)
    return share, rest, depths


def _edge_depths(whole: F64, shared: F64) -> F32:
    """(Q, 4) how deep parts of rectangles, both (Q, 4), cover their edges; 0 where half of an edge is free."""
    extent, part = whole[:, 2:] - whole[:, :2], shared[:, 2:] - shared[:, :2]
    covers = (part >= MIN_EDGE_SHARE * extent)[:, ::-1]  # an upright edge is covered along the height
    gaps = np.stack([shared[:, :2] - whole[:, :2], whole[:, 2:] - shared[:, 2:]], 1)
    depths = np.where(covers[:, None] & (gaps <= EDGE_REACH * extent[:, None]), gaps + part[:, None], 0.0)
    return depths.reshape(len(whole), 4).astype(np.float32)


def _intersections(first: F32, second: F32) -> F64:
    """(Q, 4) intersections of rectangles; inverted where empty."""
    low, high = np.maximum(first[:, :2], second[:, :2]), np.minimum(first[:, 2:], second[:, 2:])
    return np.concatenate([low, high], 1).astype(np.float64)


def _in_front(boxes: Boxes3D, seen: InView, positions_site: F64, front: Indices, back: Indices) -> Bools:
    """(Q,) whether a box is between the camera and another one; by distance where no line separates them."""
    cameras, rows, others = positions_site[seen.cameras[front], :2], seen.rows[front], seen.rows[back]
    both = np.concatenate([rows, others]), np.concatenate([others, rows]), np.concatenate([cameras, cameras])
    own_side, other_side = (side.reshape(2, len(rows)) for side in _separated(boxes, *both))
    is_ahead, is_behind = own_side[0] | other_side[1], other_side[0] | own_side[1]
    return np.where(is_ahead == is_behind, seen.ranges_m[front] < seen.ranges_m[back], is_ahead)


def _separated(boxes: Boxes3D, rows: I64, others: I64, cameras: F64) -> tuple[Bools, Bools]:
    """(Q,) whether a side of a box separates it from another, with the camera on its side; (Q,) on the other side."""
    half, yaws = boxes.sizes[rows, :2] / 2, boxes.yaws[rows]
    gap, camera = _turned(np.array([boxes.centers[others, :2], cameras]) - boxes.centers[rows, :2], yaws)
    turn = boxes.yaws[others] - yaws
    cos, sin, other_half = np.abs(np.cos(turn)), np.abs(np.sin(turn)), boxes.sizes[others, :2] / 2
    reach = cos[:, None] * other_half + sin[:, None] * other_half[:, ::-1]
    separated, beyond = np.abs(gap) - reach >= half, np.sign(gap) * camera >= half
    return np.asarray((separated & ~beyond).any(1)), np.asarray((separated & beyond).any(1))


def _turned(offsets: F64, yaws: F64) -> F64:
    """(..., Q, 2) offsets along the length and the width of Q boxes."""
    cos, sin, x, y = np.cos(yaws), np.sin(yaws), offsets[..., 0], offsets[..., 1]
    return np.stack([x * cos + y * sin, y * cos - x * sin], -1)


def _uncovered(whole: F64, covers: F64) -> tuple[F64, F64]:
    """(B,) covered shares of rectangles (B, 4) under others within them, (B, K, 4); (B, 4) rectangles around the rest.

    Between two places where a rectangle begins or ends, across or down, everything is either covered or free.
    """
    corners = np.concatenate([whole[:, None], covers], 1).reshape(len(whole), 2 + 2 * covers.shape[1], 2)
    ticks = np.sort(corners.transpose(2, 0, 1))  # (2, B, ...) across and down
    begin, end = ticks[..., None, :-1], ticks[..., None, 1:]
    low, high = (covers[..., side].transpose(2, 0, 1)[..., None] for side in (slice(2), slice(2, 4)))
    in_x, in_y = np.asarray((low <= begin) & (end <= high))
    x_steps, y_steps = ticks[..., 1:] - ticks[..., :-1]
    area = y_steps[:, :, None] * x_steps[:, None, :]
    free = np.asarray((area > 0) & ~(in_y[..., None] & in_x[:, :, None]).any(1))
    left_px2 = (area * free).sum((1, 2))
    is_free = np.array([free.any(1), free.any(2)])
    first = np.where(is_free, ticks[..., :-1], np.inf).min(2)
    last = np.where(is_free, ticks[..., 1:], -np.inf).max(2)
    share = 1.0 - (left_px2 / (whole[:, 2:] - whole[:, :2]).prod(1)).clip(0.0, 1.0)
    return share, np.where(is_free[0].any(1)[:, None], np.concatenate([first, last]).T, whole)


def _cut_rectangles(corners: F64, cameras: CameraArrays) -> F32:
    """(P, 4) rectangles around boxes that may reach behind the camera, as `CameraModel.project_boxes`."""
    ahead = corners @ cameras.rotations.swapaxes(1, 2) + cameras.translations[:, None]
    return cameras.lenses.rectangles_of_boxes(ahead, cameras.image_sizes).astype(np.float32)


def _in_pyramids(centers_camera: F64, radii_m: F64, arrays: CameraArrays) -> Bools:
    """(C, N) whether the sphere around each box reaches into the view pyramid of a camera without distortion."""
    planes, lengths = _pyramids(arrays)
    inside = centers_camera @ planes.swapaxes(1, 2) > -radii_m[:, None] * lengths[:, None]
    return np.asarray((centers_camera[..., 2] + radii_m > NEAR_M) & inside.all(2))


@lru_cache(maxsize=4)
def _pyramids(arrays: CameraArrays) -> tuple[F64, F64]:
    """(C, 4, 3) planes through each camera and each border of its image, positive inside, and (C, 4) their lengths."""
    K = arrays.lenses.K[:, :2]
    left_top, right_bottom = K.copy(), -K
    left_top[..., 2] += 0.5
    right_bottom[..., 2] += arrays.image_sizes - 0.5
    planes = np.concatenate([left_top, right_bottom], 1)
    return planes, np.sqrt((planes * planes).sum(2))
