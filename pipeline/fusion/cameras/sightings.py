"""The 2D boxes of all cameras of a frame as one table, with the directions of their edges and their uncertainty.

Directions are from the camera, without lens distortion; objects are assumed upright. Images of cameras that are mounted
on their side or upside down are taken as if turned upright.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Table, pairs_of_equal
from lidcam.pipeline.core.camera import BORDER_PX
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.optics.upright import TURNS, quarter_turns, turned
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.found import FoundBoxes
from lidcam.pipeline.fusion.projection import CameraArrays, camera_arrays

MIN_PX = 0.5
"""Minimum width and height of a box, pixels."""

CUT_EDGE_SIGMA = 10.0
"""Standard deviation of an edge cut by the border of the image, as a share of the box: it is unknown."""

HIDDEN_EDGE_SIGMA = 0.25
"""Standard deviation of an edge that another object may hide, as a share of the box."""

MIN_HIDDEN_SHARE = 0.3
"""Minimum share of an edge that the box of a nearer object covers, to hide it."""

MIN_LOWER_SHARE = 0.05
"""Minimum offset of the lower edge of a nearer object below another's, as a share of the latter's box."""

_AROUND = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])


@dataclass(frozen=True, eq=False)
class Sightings(Table):
    """P 2D boxes, camera by camera, and in each by falling score, then by class and position."""

    cameras: I64  # (P,) int64 number of the camera, in the order of the views
    rows: I64  # (P,) int64 row of `Boxes2D` of that camera
    xyxy: F64  # (P, 4) float64 left, top, right, bottom in pixels, clipped to the image
    upright: F64  # (P, 4) float64 the same in the upright image
    cut: Bools  # (P, 4) whether each of these edges of the upright image lies at its border
    scores: F64  # (P,) float64 in [0, 1]
    class_ids: I64  # (P,) int64
    stamps_ns: I64  # (P,) int64 time of the image
    views: CameraArrays  # The P boxes' cameras
    origin: F64  # (P, 3) float64 the camera, metres in the site frame
    # (P, 8, 3) float64 directions of the corners and the middles of the edges, clockwise from the left top corner of
    # the upright image, in the site frame; of depth 1
    rays: F64
    T_camera_site: F64  # (P, 3, 4) float64 the site in the optical frame of the upright image, metres

    @property
    def headings(self) -> F64:
        """(P, 2) unit vectors from the camera to the middle of each 2D box, seen from above."""
        middle = self.rays[:, 3, :2] + self.rays[:, 7, :2]
        return np.asarray(middle / np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)[:, None])


class Noise(NamedTuple):
    """Standard deviations of the inputs of a placement."""

    pixel_px: float  # Edge of a 2D box
    outline: float  # Edge of a 2D box, as a share of the root of its area, in addition
    ground_m: float  # Height of the ground
    ground_slope: float  # Slope of the ground between camera and object, rise over run
    bearing_rad: float  # Direction of a camera about the vertical


class Observed(NamedTuple):
    """P 2D boxes as (P,) float64 each."""

    left: F64  # Bearing of the left edge about +z of the site, radians
    width: F64  # Bearing of the left edge minus that of the right one, radians
    lower: F64  # Slope of the ray to the middle of the lower edge, rise over run; negative downwards
    upper: F64  # Slope of the ray to the middle of the upper edge
    stds: F64  # (P, 4) standard deviations of left, top, right and bottom: bearings in radians, slopes rise over run

    @property
    def middle(self) -> F64:
        """Bearing of the middle of the box, radians."""
        return self.left - self.width / 2


def see(views: Mapping[str, CameraSensor], boxes2d: Mapping[str, Boxes2D]) -> Sightings:
    """The boxes of all cameras, but for those outside of the image, partly beyond its lens model, or below the camera.

    A box that reaches around the point straight below the camera has no bearing, and its upper edge is not above its
    lower one.
    """
    found = FoundBoxes.of(boxes2d, tuple(views))
    rig = camera_arrays(tuple(views.values()))
    cameras = rig.select(found.cameras)
    limits = cameras.limits
    xyxy = found.xyxy.astype(np.float64).clip(0, limits)
    around = xyxy[:, None, :2] + _AROUND * (xyxy[:, 2:] - xyxy[:, :2])[:, None]
    rays, sound = cameras.lenses.rays_of_pixels(around)
    quarters = quarter_turns(cameras.rotations)
    cut = np.concatenate([xyxy[:, :2] <= BORDER_PX, xyxy[:, 2:] >= limits[:, 2:] - BORDER_PX], 1)
    edges, corners = (np.arange(count) + quarters[:, None] * count // 4 for count in (4, 8))
    matrices = np.concatenate([cameras.rotations, cameras.translations[..., None]], 2)
    table = Sightings(
        cameras=found.cameras,
        rows=found.rows,
        xyxy=xyxy,
        upright=turned(xyxy, quarters, cameras.image_sizes),
        cut=np.take_along_axis(cut, edges % 4, 1),
        scores=found.scores.astype(np.float64),
        class_ids=found.class_ids.astype(np.int64),
        stamps_ns=found.stamps_ns,
        views=cameras,
        origin=rig.positions[found.cameras],
        rays=np.take_along_axis(rays @ cameras.rotations, corners[..., None] % 8, 1),
        T_camera_site=TURNS[quarters] @ matrices,
    )
    is_visible = np.isfinite(xyxy).all(1) & np.asarray(sound.all(1)) & (xyxy[:, 2:] - xyxy[:, :2] >= MIN_PX).all(1)
    ahead, up = (table.rays[..., :2] * table.headings[:, None]).sum(2), table.rays[..., 2]
    is_visible &= (ahead > 0).all(1) & (up[:, 1] * ahead[:, 5] > up[:, 5] * ahead[:, 1])
    return table if is_visible.all() else table.select(np.flatnonzero(is_visible))


def observe(sightings: Sightings, noise: Noise) -> Observed:
    """The directions and extents of 2D boxes, and their uncertainty."""
    rays, xyxy = sightings.rays, sightings.upright
    slopes = rays[..., 2] / np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-9)
    bearings = np.arctan2(rays[..., 1], rays[..., 0])
    width, lower, upper = wrap_angle(bearings[:, 7] - bearings[:, 3]), slopes[:, 5], slopes[:, 1]
    extent_px = xyxy[:, 2:] - xyxy[:, :2]
    variances = (noise.pixel_px**2 + noise.outline**2 * extent_px.prod(1, keepdims=True)) / extent_px**2
    variances = np.concatenate([variances, variances], 1)
    variances[_hidden_edges(sightings.cameras, xyxy) & ~sightings.cut] += HIDDEN_EDGE_SIGMA**2
    variances[sightings.cut] += CUT_EDGE_SIGMA**2
    extent = np.abs(np.stack([width, upper - lower], 1))
    return Observed(bearings[:, 7], width, lower, upper, np.concatenate([extent, extent], 1) * np.sqrt(variances))


def _hidden_edges(cameras: I64, xyxy: F64) -> Bools:
    """(P, 4) whether a nearer object, whose box reaches further down, may hide each edge of each box."""
    rows, others = pairs_of_equal(cameras, cameras)
    is_nearer = xyxy[others, 3] > xyxy[rows, 3] + MIN_LOWER_SHARE * (xyxy[rows, 3] - xyxy[rows, 1])
    hidden = np.zeros(xyxy.shape, np.bool_)
    rows, others = rows[is_nearer], others[is_nearer]
    left, top, right, bottom = xyxy[rows].T
    other_left, other_top, other_right, other_bottom = xyxy[others].T
    width, height = right - left, bottom - top
    is_beside = np.minimum(bottom, other_bottom) - np.maximum(top, other_top) >= MIN_HIDDEN_SHARE * height
    is_below = np.minimum(right, other_right) - np.maximum(left, other_left) >= MIN_HIDDEN_SHARE * width
    outer_left, outer_right = left - MIN_LOWER_SHARE * width, right + MIN_LOWER_SHARE * width
    hidden[rows[is_beside & (other_left < outer_left) & (other_right > outer_left)], 0] = True
    hidden[rows[is_beside & (other_left < outer_right) & (other_right > outer_right)], 2] = True
    hidden[rows[is_below & (other_top < bottom)], 3] = True
    return hidden
