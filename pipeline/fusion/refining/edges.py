"""The edges of 2D boxes matched with 3D boxes, as measurements of their position.

Edges moved by something other than the object have larger errors. The border of an image moves edges that it does not
cut: the 2D box of a bus that reaches below the image ends on the left where its side leaves the image, not at its rear.
Occluders move edges inward. And a common shift of most 2D boxes of an image comes from a wrong calibration, and would
draw every object aside.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Table
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses
from lidcam.pipeline.core.geometry.box_edges import BOX_EDGES
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import CameraArrays, camera_arrays

MIN_INWARD_SIGMAS = 2.5
"""Minimum inward offset of an edge, in standard deviations, before it may be the edge of an occluder."""

MIN_SHIFT_SIGMAS = 3.0
"""Minimum common shift, in standard deviations, that is not chance."""

MEDIAN_SPREAD = 1.2533
"""Standard deviation of a median, as a multiple of that of a mean."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEdges(Table):
    """P pairs of a 3D box and a 2D box, sorted by the 3D box."""

    rows: I64  # (P,) int64 row of the 3D box
    camera_rows: I64  # (P,) int64 number of the camera, in the order of the views
    cameras: CameraArrays  # P cameras
    xyxy: F64  # (P, 4) float64 left, top, right, bottom of the 2D box, clipped to the image, pixels
    sigma_px: F64  # (P, 4) float64 standard deviation of each edge
    hidden_px: F64  # (P, 4) float64 maximum inward displacement of each edge by occluders
    later_s: F64  # (P,) float64 time of the image after that of the 3D box, seconds


def measured_edges(
    hypotheses: Hypotheses,
    boxes2d: Mapping[str, Boxes2D],
    views: Mapping[str, CameraSensor],
    config: FuseConfig,
) -> MeasuredEdges:
    """All matched 2D boxes of a frame, with errors by `pixel_sigma_px` and `outline_sigma` of the settings."""
    numbered = [(k, name) for k, name in enumerate(views) if name in boxes2d and hypotheses.matches.get(name)]
    matched = [(hypotheses.matches[name], boxes2d[name]) for _, name in numbered]
    counts = [len(matches) for matches, _ in matched]
    rows = np.concatenate([np.zeros(0, np.int64), *(matches.pairs[:, 0] for matches, _ in matched)])
    order = np.argsort(rows, kind="stable")
    rows, numbers = rows[order], np.repeat(np.array([number for number, _ in numbered], np.int64), counts)[order]
    stamps_ns = np.repeat(np.array([found.stamp_ns for _, found in matched], np.int64), counts)[order]
    xyxy = np.concatenate([np.zeros((0, 4)), *(found.xyxy[matches.pairs[:, 1]] for matches, found in matched)])[order]
    hidden = np.concatenate([np.zeros(0), *(matches.hidden[matches.pairs[:, 0]] for matches, _ in matched)])[order]
    cameras = camera_arrays(tuple(views.values())).select(numbers)
    xyxy = xyxy.clip(0.0, cameras.limits)
    extent = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 1.0)
    outline_px = config.outline_sigma * np.sqrt(extent[:, :1] * extent[:, 1:])
    sigma_px = np.repeat(np.hypot(config.pixel_sigma_px, outline_px), 4, axis=1)
    hidden_px = hidden[:, None] * np.concatenate([extent, extent], 1)
    later_s = (stamps_ns - hypotheses.boxes.measured_ns[rows]) * 1e-9
    return MeasuredEdges(rows, numbers, cameras, xyxy, sigma_px, hidden_px, later_s)


def moved_by_borders(boxes: Boxes3D, rows: I64, cameras: CameraArrays) -> F64:
    """(P, 4) inward displacement of left, top, right and bottom of a box by the border of the image, pixels.

    The upper and lower border displace left and right, the sides top and bottom; a box outside of the image is
    displaced by its whole extent. Lines between corners are taken as straight.

    Args:
        boxes: N boxes.
        rows: (P,) the box in the image of each camera, wholly in front of it.
        cameras: P cameras.
    """
    corners = box_corners(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows])
    in_cameras = corners @ cameras.rotations.swapaxes(1, 2) + cameras.translations[:, None]
    pixels, _ = cameras.lenses.project(in_cameras)
    beyond = np.flatnonzero(((pixels < 0) | (pixels > cameras.image_sizes[:, None])).any((1, 2)))
    moved = np.zeros((len(rows), 4))
    if not len(beyond):
        return moved
    along, limit = pixels[beyond].transpose(2, 0, 1), cameras.image_sizes[beyond].T[::-1, :, None]
    other, (start, end) = along[::-1], BOX_EDGES.T  # u and v, and v and u
    a, b, c, d = along[..., start], along[..., end], other[..., start], other[..., end]
    places, is_left = [along], [(other >= 0) & (other <= limit)]
    for border in (0.0, limit):
        places.append(a + (b - a) * (border - c) / np.where(c == d, 1.0, d - c))
        is_left.append((np.minimum(c, d) < border) & (border < np.maximum(c, d)))
    place, left = np.concatenate(places, 2), np.concatenate(is_left, 2)
    low, high = np.where(left, place, np.inf).min(2), np.where(left, place, -np.inf).max(2)
    whole_low, whole_high = along.min(2), along.max(2)
    inside = np.concatenate([np.minimum(low, whole_high) - whole_low, whole_high - np.maximum(high, whole_low)])
    moved[beyond] = inside.T.clip(0.0)
    return moved


def doubted_edges(
    edges: MeasuredEdges, cut_px: F64, predicted: F64, jacobian: F64, covariances: F64, is_own: Bools
) -> MeasuredEdges:
    """The edges with additional noise where something other than the box moves them.

    These are edges cut by the border of the image, inward ones of partly hidden objects, and all edges of a camera
    with a common shift.

    Args:
        edges: P pairs.
        cut_px: (P, 4) from `moved_by_borders`.
        predicted: (P, 4) edges of the projected boxes, pixels.
        jacobian: (P, 4, 3) derivatives of these by x, y and yaw.
        covariances: (N, 3, 3) of the boxes over these.
        is_own: (P,) pairs of boxes that are not turned, which define the common shifts.
    """
    sigma_px, residuals, of_box = np.hypot(edges.sigma_px, cut_px), edges.xyxy - predicted, covariances[edges.rows]
    by_box = (jacobian @ of_box * jacobian).sum(2)
    is_inside = residuals * [1, 1, -1, -1] > MIN_INWARD_SIGMAS * np.sqrt(by_box + sigma_px**2)
    sigma_px = np.hypot(sigma_px, np.where(is_inside, edges.hidden_px, 0.0))
    slopes = (jacobian[:, :2] + jacobian[:, 2:]) / 2
    variances = (slopes @ of_box * slopes).sum(2) + (sigma_px[:, :2] ** 2 + sigma_px[:, 2:] ** 2) / 4
    whole = np.flatnonzero(is_own & ((edges.xyxy > 0) & (edges.xyxy < edges.cameras.limits)).all(1))
    offsets = (residuals[whole, :2] + residuals[whole, 2:]) / 2
    count = int(edges.camera_rows.max(initial=-1)) + 1
    shifts = camera_shifts(edges.camera_rows[whole], offsets, variances[whole], count=count)
    return replace(edges, sigma_px=np.hypot(sigma_px, np.concatenate([shifts, shifts], 1)[edges.camera_rows]))


def camera_shifts(camera_rows: I64, residuals_px: F64, variances_px2: F64, *, count: int) -> F64:
    """(C, 2) common shift of the 2D boxes of each camera to the right and down, pixels; 0 where it may be chance.

    Args:
        camera_rows: (P,) row of the camera of each pair.
        residuals_px: (P, 2) centre of each 2D box less that of the projected box.
        variances_px2: (P, 2) expected variances of the residuals.
        count: Number of cameras.
    """
    shifts, both = np.zeros((count, 2)), np.concatenate([residuals_px, variances_px2], 1)
    for camera in set(camera_rows.tolist()):
        pairs = (camera_rows == camera).nonzero()[0]
        shift, variance = _median(both[pairs]).reshape(2, 2)
        min_shift = MIN_SHIFT_SIGMAS * MEDIAN_SPREAD * np.sqrt(variance / len(pairs))
        shifts[camera] = np.where(np.abs(shift) > min_shift, shift, 0.0)
    return shifts


def _median(values: F64) -> F64:
    """The median of each column; `np.median` takes ten times as long for few rows."""
    ordered = np.sort(values, axis=0)
    return np.asarray((ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2)
