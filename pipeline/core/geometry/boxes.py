"""Oriented boxes, upright rectangles and angles."""

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, Array

UNIT_CORNERS = np.array(
    [[1.0, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]]
)
"""(8, 3) corners of a box along its own axes, in units of half its size, in the order of `box_corners`."""


def wrap_angle(angles_rad: npt.ArrayLike) -> F64:
    """Angles wrapped to (-pi, pi]."""
    angles = np.asarray(angles_rad, np.float64)
    wrapped = angles - 2 * np.pi * np.ceil((angles - np.pi) / (2 * np.pi))
    return np.where(wrapped <= -np.pi, np.pi, np.minimum(wrapped, np.pi))  # rounding may overshoot at both ends


def rotations_2d(yaws: F64) -> F64:
    """(N, 2, 2) rotation matrices of the angles `yaws` (N,)."""
    cos, sin = np.cos(yaws), np.sin(yaws)
    rotations = np.empty((len(yaws), 2, 2))
    rotations[:, 0, 0], rotations[:, 0, 1] = cos, -sin
    rotations[:, 1, 0], rotations[:, 1, 1] = sin, cos
    return rotations


def box_corners(centers: F64, sizes: F64, yaws: F64) -> F64:
    """The corners (N, 8, 3) of boxes by their centres (N, 3), sizes (N, 3) and yaws (N,) about +z, metres.

        4 ------ 5        corners 0-3 are the bottom, counter-clockwise from front left seen from above:
       /|       /|        0 (+l, +w), 1 (-l, +w), 2 (-l, -w), 3 (+l, -w); 4-7 are above 0-3.
      7 ------ 6 |
      | 0 -----|-1
      |/       |/
      3 ------ 2

    Sizes are length, width, height.
    """
    local = UNIT_CORNERS / 2 * sizes[:, None]
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    corners = np.empty(local.shape)
    corners[..., 0] = local[..., 0] * cos - local[..., 1] * sin
    corners[..., 1] = local[..., 0] * sin + local[..., 1] * cos
    corners[..., 2] = local[..., 2]
    return corners + centers[:, None]


def iou_xyxy(first: Array, second: Array) -> F64:
    """(N, M) IoU of each of N upright rectangles with each of M, in [0, 1]; see `pair_overlaps_xyxy`."""
    return pair_overlaps_xyxy(np.asarray(first)[:, None], np.asarray(second)[None])[0]


def pair_overlaps_xyxy(first: Array, second: Array) -> tuple[F64, F64]:
    """Intersection over union, plain and generalised, of pairs of rectangles (..., 4): left, top, right, bottom.

    The generalised one (Rezatofighi et al., "Generalized Intersection over Union", CVPR 2019) is the plain one less the
    share of the smallest rectangle around both that neither fills: it tells near misses from far ones. Returns (...) in
    [0, 1], 0 if a rectangle is empty, inverted or not finite; (...) in [-1, 1], then -1.
    """
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    with np.errstate(invalid="ignore"):
        extent_a, extent_b = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
        shared = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
        around = np.maximum(a[..., 2:], b[..., 2:]) - np.minimum(a[..., :2], b[..., :2])
        sound = ((extent_a > 0) & (extent_b > 0) & np.isfinite(around)).all(-1)
        intersection = np.where(sound & (shared > 0).all(-1), shared[..., 0] * shared[..., 1], 0.0)
        areas = extent_a[..., 0] * extent_a[..., 1] + extent_b[..., 0] * extent_b[..., 1]
        union = np.where(sound, areas - intersection, 1.0)
        whole = np.where(sound, around[..., 0] * around[..., 1], 1.0)
    iou = intersection / union
    return np.asarray(iou), np.where(sound, iou - (whole - union) / whole, -1.0)
