"""The 2D boxes of all cameras of a frame as one table, with the directions of their edges and how well they are known.

Directions are from the camera, without lens distortion; objects are taken to stand upright.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, Table
from lidcam.pipeline.core.camera import BORDER_PX
from lidcam.pipeline.core.detections import Boxes2D
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.found import FoundBoxes, pairs_of_images
from lidcam.pipeline.fusion.projection import CameraArrays, camera_arrays

MIN_PX = 0.5
"""A box that is narrower or lower shows nothing."""

CUT_SHARE = 10.0
"""Standard deviation of an edge that the border of the image has cut, as a share of the box: nothing is known of it."""

HIDDEN_SHARE = 0.25
"""The same of an edge that another object may hide."""

HIDDEN_EDGE_SHARE = 0.3
"""A nearer object hides an edge if its box covers this share of it."""

NEARER_SHARE = 0.05
"""An object is nearer than another one if its lower edge is further down by this share of the other one's box."""

_AROUND = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])


@dataclass(frozen=True, eq=False)
class Sightings(Table):
    """P 2D boxes, camera after camera, and in each by falling score, then by class and place.

    Attributes:
        cameras: (P,) int64 number of the camera, in the order of the views.
        rows: (P,) int64 row of `Boxes2D` of that camera.
        xyxy: (P, 4) float64 left, top, right, bottom in pixels, clipped to the image.
        cut: (P, 4) whether each of these edges lies at the border of the image.
        scores: (P,) float64 in [0, 1].
        class_ids: (P,) int64.
        stamps_ns: (P,) int64 time of the image.
        views: Of the P boxes' cameras.
        origin: (P, 3) float64 the camera, metres in the site frame.
        rays: (P, 8, 3) float64 directions of the corners and the middles of the edges, clockwise from the left top
            corner, in the site frame; of depth 1.
    """

    cameras: I64
    rows: I64
    xyxy: F64
    cut: Bools
    scores: F64
    class_ids: I64
    stamps_ns: I64
    views: CameraArrays
    origin: F64
    rays: F64


class Noise(NamedTuple):
    """Standard deviations of the inputs of a placement.

    Attributes:
        pixel_px: An edge of a 2D box.
        outline: The same, as a share of the box's size, the root of its area; both add up.
        ground_m: Height of the ground.
        ground_slope: Slope of the ground between camera and object, rise over run.
        bearing_rad: Direction of a camera about the vertical.
    """

    pixel_px: float
    outline: float
    ground_m: float
    ground_slope: float
    bearing_rad: float


class Observed(NamedTuple):
    """P 2D boxes as (P,) float64 each.

    Attributes:
        left: Bearing of the left edge about +z of the site, radians.
        width: Bearing of the left edge minus that of the right one, radians.
        lower: Slope of the ray to the middle of the lower edge, rise over run; below 0 downwards.
        upper: The same of the upper edge.
        stds: (P, 4) Standard deviations of left, top, right and bottom: of the bearings in radians, of the slopes as
            `lower` and `upper`.
    """

    left: F64
    width: F64
    lower: F64
    upper: F64
    stds: F64

    @property
    def middle(self) -> F64:
        """Bearing of the middle of the box, radians."""
        return self.left - self.width / 2


def see(views: Mapping[str, CameraSensor], boxes2d: Mapping[str, Boxes2D]) -> Sightings:
    """The boxes of every camera that has some, but for boxes that leave nothing of themselves in it."""
    found = FoundBoxes.of(boxes2d, tuple(views))
    rig = camera_arrays(tuple(views.values()))
    cameras = rig.select(found.cameras)
    limits = cameras.limits
    xyxy = found.xyxy.astype(np.float64).clip(0, limits)
    around = xyxy[:, None, :2] + _AROUND * (xyxy[:, 2:] - xyxy[:, :2])[:, None]
    rays, sound = cameras.lenses.rays_of_pixels(around)
    table = Sightings(
        found.cameras,
        found.rows,
        xyxy,
        np.concatenate([xyxy[:, :2] <= BORDER_PX, xyxy[:, 2:] >= limits[:, 2:] - BORDER_PX], 1),
        found.scores.astype(np.float64),
        found.class_ids.astype(np.int64),
        found.stamps_ns,
        cameras,
        rig.positions[found.cameras],
        rays @ cameras.rotations,
    )
    shown = np.isfinite(xyxy).all(1) & np.asarray(sound.all(1)) & (xyxy[:, 2:] - xyxy[:, :2] >= MIN_PX).all(1)
    return table if shown.all() else table.select(np.flatnonzero(shown))


def observe(sightings: Sightings, noise: Noise) -> Observed:
    """The directions and extents of 2D boxes, and how well they are known."""
    rays, xyxy = sightings.rays, sightings.xyxy
    slopes = rays[..., 2] / np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-9)
    bearings = np.arctan2(rays[..., 1], rays[..., 0])
    width, lower, upper = wrap_angle(bearings[:, 7] - bearings[:, 3]), slopes[:, 5], slopes[:, 1]
    extent_px = xyxy[:, 2:] - xyxy[:, :2]
    variances = (noise.pixel_px**2 + noise.outline**2 * extent_px.prod(1, keepdims=True)) / extent_px**2
    variances = np.concatenate([variances, variances], 1)
    variances[_hidden_edges(sightings.cameras, xyxy) & ~sightings.cut] += HIDDEN_SHARE**2
    variances[sightings.cut] += CUT_SHARE**2
    extent = np.abs(np.stack([width, upper - lower], 1))
    return Observed(bearings[:, 7], width, lower, upper, np.concatenate([extent, extent], 1) * np.sqrt(variances))


def _hidden_edges(cameras: I64, xyxy: F64) -> Bools:
    """(P, 4) whether a nearer object, whose box reaches further down, may hide each edge of each box."""
    rows, others = pairs_of_images(cameras, cameras)
    is_nearer = xyxy[others, 3] > xyxy[rows, 3] + NEARER_SHARE * (xyxy[rows, 3] - xyxy[rows, 1])
    hidden = np.zeros(xyxy.shape, np.bool_)
    if not is_nearer.any():
        return hidden
    rows, others = rows[is_nearer], others[is_nearer]
    left, top, right, bottom = xyxy[rows].T
    other_left, other_top, other_right, other_bottom = xyxy[others].T
    width, height = right - left, bottom - top
    is_beside = np.minimum(bottom, other_bottom) - np.maximum(top, other_top) >= HIDDEN_EDGE_SHARE * height
    is_below = np.minimum(right, other_right) - np.maximum(left, other_left) >= HIDDEN_EDGE_SHARE * width
    outer_left, outer_right = left - NEARER_SHARE * width, right + NEARER_SHARE * width
    hidden[rows[is_beside & (other_left < outer_left) & (other_right > outer_left)], 0] = True
    hidden[rows[is_beside & (other_left < outer_right) & (other_right > outer_right)], 2] = True
    hidden[rows[is_below & (other_top < bottom)], 3] = True
    return hidden
