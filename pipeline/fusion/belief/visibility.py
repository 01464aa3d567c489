"""Visibility of each hypothesis for each camera: whether it is in view, how much is hidden, and its 2D box.

A camera sees nothing behind a point of the cloud. The points of all lidars are sorted into cells of each camera's field
of view, and each cell keeps the range of its nearest point (a depth buffer: Catmull, A subdivision algorithm for
computer display of curved surfaces, 1974). The hidden share of an object is that of its cells with a point nearer than
its near side; cells without a point do not count.

Occlusion does not depend on the lens: cells are of equal size in the plane one metre ahead of a camera, without
distortion. The ground is left out, since a cell at the foot of an object also holds the ground in front of it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, Bools, Indices, check_array
from lidcam.pipeline.core.camera import BORDER_PX, NEAR_M, CameraModel
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.native.kernels import nearest_in_cells

MAX_POINTS = 3000
"""Maximum number of points per frame, evenly thinned: occluders are large."""

COLUMNS, ROWS = 32, 24
"""Number of cells of a field of view, across and down."""

VIEW_MARGIN = 1.2
"""Scale of the cells' field of view against that of a lens without distortion: most distortions show more."""

MAX_VIEW_TANGENT = 4.0
"""Maximum tangent of the angle to the axis that has cells; nothing is hidden beyond."""

MAX_RANGE_SHARE = 0.97
"""Maximum range of a point that hides an object, as a share of the range of its near side."""

MAX_SCORE = 0.98
"""Maximum probability that a 2D box is right."""

FREE_CELLS = 1.0
"""Pseudo-count of free cells (smoothing), so that a single point hides nothing entirely."""


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """Visibility of N hypotheses for the C cameras with 2D boxes in this frame, or an empty list of them."""

    cameras: tuple[str, ...]  # (C) names
    in_view: Bools  # (C, N) bool, whether a part of the box lies in the image
    size_px: F64  # (C, N) float64, geometric mean of width and height of its rectangle, pixels; 0 out of view
    visible: F64  # (C, N) float64 in [0, 1], share that no other object and no point hides; 0 out of view
    is_cut: Bools  # (C, N) bool, whether it reaches the border of the image
    is_matched: Bools  # (C, N) bool, whether it has a 2D box
    scores: F64  # (C, N) float64, score of that box; 0 without one
    iou: F64  # (C, N) float64, overlap with that box; 0 without one
    agreement: F64  # (C, N) float64, `class_agreement` of that box with the hypothesis; 0 without one
    log_false: F64  # (C,) float64, logarithm of the probability that all 2D boxes of the camera are false

    def __post_init__(self) -> None:
        shape = self.in_view.shape
        for name in ("size_px", "visible", "scores", "iou", "agreement"):
            check_array(name, getattr(self, name), shape, np.float64)
        for name in ("in_view", "is_cut", "is_matched"):
            check_array(name, getattr(self, name), shape, np.bool_)
        check_array("log_false", self.log_false, shape[:1], np.float64)


def find_visibility(
    hypotheses: Hypotheses,
    boxes2d: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
    combined: CombinedCloud,
    agreement: F64,
    unknown_ids: Collection[int] = (),
) -> Visibility:
    """Visibility of N hypotheses in the site frame for the cameras of `boxes2d`.

    Args:
        hypotheses: Boxes and their matches.
        boxes2d: By camera name; a camera without an entry did not look.
        views: The cameras at the times of their images.
        combined: Clouds that may hide something.
        agreement: (K, K) from `class_agreement`.
        unknown_ids: `Detect2D.unknown_ids`. Boxes of these classes count as out of view unless they have a 2D box.
    """
    boxes, cameras = hypotheses.boxes, tuple(name for name in hypotheses.matches if name in boxes2d)
    shape = len(cameras), len(boxes)
    visible, scores, iou, agreed = (np.zeros(shape) for _ in range(4))
    is_matched = np.zeros(shape, np.bool_)
    log_false = np.array([np.log1p(-boxes2d[name].scores.clip(max=MAX_SCORE)).sum() for name in cameras], np.float64)
    if not cameras or not len(boxes):
        out_of_view, size_px = np.zeros(shape, np.bool_), np.zeros(shape)
        return Visibility(
            cameras, out_of_view, size_px, visible, out_of_view, is_matched, scores, iou, agreed, log_false
        )
    matches, models = [hypotheses.matches[name] for name in cameras], [views[name].model for name in cameras]
    rows, found = np.concatenate([one.pairs for one in matches]).T
    camera = np.repeat(np.arange(len(cameras)), [len(one) for one in matches])
    found += np.cumsum([0, *(len(boxes2d[name]) for name in cameras)])[camera]
    is_matched[camera, rows] = True
    projected = np.array([one.projected_xyxy for one in matches])
    in_view = np.isfinite(projected[..., 0]) & (is_matched | ~np.isin(boxes.class_ids, [*unknown_ids]))
    xyxy = np.where(in_view[..., None], projected, np.float32(0))
    extent = xyxy[..., 2:] - xyxy[..., :2]
    border = np.array([(model.width_px, model.height_px) for model in models], np.float32)[:, None] - BORDER_PX
    is_cut = in_view & ((xyxy[..., :2] <= BORDER_PX) | (xyxy[..., 2:] >= border)).any(2)
    pairs = in_view.nonzero()
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    covered = hidden_by_points([views[name] for name in cameras], combined.detection_cloud.xyz, corners, *pairs)
    visible[pairs] = 1 - np.maximum(covered, np.array([one.hidden for one in matches])[pairs])
    named = np.concatenate([boxes2d[name].class_ids for name in cameras])[found]
    agreed[camera, rows] = agreement[boxes.class_ids[rows], named]
    scores[camera, rows] = np.concatenate([boxes2d[name].scores for name in cameras])[found]
    iou[camera, rows] = np.concatenate([one.iou for one in matches])
    size_px = np.sqrt(extent.prod(2).astype(np.float64))
    return Visibility(cameras, in_view, size_px, visible, is_cut, is_matched, scores, iou, agreed, log_false)


def hidden_by_points(
    views: Sequence[CameraSensor], xyz_site: F32, corners_site: F64, cameras: Indices, objects: Indices
) -> F64:
    """(Q,) share of an object in [0, 1) that nearer points cover in the view of a camera.

    Args:
        views: C cameras at the times of their images.
        xyz_site: (P, 3) points in the site frame, metres.
        corners_site: (N, 8, 3) corners of boxes in the site frame, metres.
        cameras: (Q,) camera of each pair.
        objects: (Q,) object of each pair.
    """
    if not len(cameras):
        return np.zeros(0)
    low, cell = _cells(tuple(view.model for view in views))
    matrices = np.array([view.T_camera_site.matrix for view in views])
    matrices32, low32, cell32 = (values.astype(np.float32) for values in (matrices, low, cell))
    sampled = np.ascontiguousarray(xyz_site[:: -(-len(xyz_site) // MAX_POINTS) or 1])
    nearest = nearest_in_cells(matrices32, low32, cell32, sampled, ROWS, COLUMNS, NEAR_M)
    corners = corners_site[objects] @ matrices[cameras, :3, :3].swapaxes(1, 2) + matrices[cameras, None, :3, 3]
    middle = corners.mean(1)
    reach_m = np.sqrt(((corners - middle[:, None]) ** 2).sum(2)).max(1)
    near_side_m = np.sqrt((middle**2).sum(1)) - reach_m
    place = (corners[..., :2] / np.maximum(corners[..., 2:], NEAR_M) - low[cameras, None]) / cell[cameras, None]
    first = np.floor(place.min(1))
    end = np.maximum(np.ceil(place.max(1)), first + 1)
    in_column, in_row = (
        (np.arange(count) >= first[:, axis, None]) & (np.arange(count) < end[:, axis, None])
        for axis, count in enumerate((COLUMNS, ROWS))
    )
    filled, ranges_m = in_row[:, :, None] & in_column[:, None], nearest[cameras]
    in_front = (filled & (ranges_m < (MAX_RANGE_SHARE * near_side_m)[:, None, None])).sum((1, 2))
    measured = (filled & np.isfinite(ranges_m)).sum((1, 2))
    return np.asarray(in_front / (measured + FREE_CELLS))


@lru_cache(maxsize=4)
def _cells(models: tuple[CameraModel, ...]) -> tuple[F64, F64]:
    """(C, 2) low ends of the fields of view across and down, and (C, 2) cell sizes, in the plane one metre ahead."""
    focal = np.array([(model.K[0, 0], model.K[1, 1]) for model in models])
    middle = np.array([(model.K[0, 2], model.K[1, 2]) for model in models])
    size = np.array([(model.width_px, model.height_px) for model in models], np.float64)
    low = np.maximum(-VIEW_MARGIN * middle / focal, -MAX_VIEW_TANGENT)
    high = np.minimum(VIEW_MARGIN * (size - middle) / focal, MAX_VIEW_TANGENT)
    return low, (high - low) / (COLUMNS, ROWS)
