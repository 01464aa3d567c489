"""The edges of 2D boxes matched with 3D boxes, as measurements of their position.

Occluders move edges inward, by any amount; and all edges in an image share the error of the camera's direction.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, Table
from lidcam.pipeline.core.detections import Boxes2D, Hypotheses
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.fusion.projection import CameraArrays, camera_arrays

HIDDEN_SHARE = 0.15
"""Probability that something without a box hides an edge."""

SIDE_NOISE = 2.0
"""Noise of left and right edges over that of upper and lower ones, where a recording does not tell: what stands beside
an object hides its sides, or joins it."""

CROWDED_NOISE = 2.0
"""Noise of an edge that lies in another 2D box over that of a free one: detectors join objects, and cut them.

Measured on 359 cars of KITTI: standard deviations of 4.4, 1.7, 3.6, 2.3 (left, top, right, bottom, in those of a free
edge by the settings) in other boxes, and of 2.3, 1.0, 2.5, 0.9 elsewhere.
"""

MIN_CROWDED_SHARE = 0.4
"""Minimum share of an edge that lies beside another 2D box, for an edge in that box."""

MAX_HIDDEN_SHARE = 0.9
"""Maximum probability that an edge is hidden."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEdges(Table):
    """P pairs of a 3D box and a 2D box, sorted by the 3D box."""

    rows: I64  # (P,) int64 row of the 3D box
    cameras: CameraArrays  # P cameras
    xyxy: F64  # (P, 4) float64 left, top, right, bottom of the 2D box, clipped to the image, pixels
    sigma_px: F64  # (P, 4) float64 standard deviation of each edge by itself
    # (P, 2) float64 standard deviations of what opposite edges share, left and right, and top and bottom, pixels: the
    # shift of the whole image, and the excess of 2D boxes outwards
    shift_px: F64
    excess_px: F64
    # (P, 4) float64 probability density of an edge that an occluder displaces inward, by up to the extent of the box,
    # over that of the true edge at its mean, both times their prior probabilities
    hidden_odds: F64
    later_s: F64  # (P,) float64 time of the image after that of the 3D box, seconds

    @property
    def shared_px2(self) -> tuple[F64, F64]:
        """(P, 1, 2) shared variance of each edge, and covariance of opposite edges, pixels^2."""
        shift, excess = self.shift_px[:, None] ** 2, self.excess_px[:, None] ** 2
        return shift + excess, shift - excess


def measured_edges(
    hypotheses: Hypotheses, boxes2d: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor], config: FuseConfig
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
    depths = (matches.edge_depths_px[matches.pairs[:, 0]].astype(np.float64) for matches, _ in matched)
    depths_px = np.concatenate([np.zeros((0, 4)), *depths])[order]
    crowded = (are_crowded(found.xyxy)[matches.pairs[:, 1]] for matches, found in matched)
    is_crowded = np.concatenate([np.zeros((0, 4), np.bool_), *crowded])[order]
    cameras = camera_arrays(tuple(views.values())).select(numbers)
    fits = [view.fit for view in views.values()]
    xyxy = xyxy.clip(0.0, cameras.limits)
    extent = np.maximum(xyxy[:, 2:] - xyxy[:, :2], 1.0)
    sides = np.concatenate([extent, extent], 1)
    default = (config.pixel_sigma_px, config.outline_sigma)
    unknown = tuple(SIDE_NOISE * sigma for sigma in default), default
    noise = np.array([fit.noise or unknown for fit in fits]).reshape(-1, 2, 2)[numbers]
    sigma_px = np.tile(np.hypot(noise[..., 0], noise[..., 1] * np.sqrt(extent.prod(1))[:, None]), 2)
    sigma_px = np.where(is_crowded, CROWDED_NOISE, 1.0) * sigma_px
    habits = np.array([fit.habits for fit in fits]).reshape(-1, 4)[numbers]
    is_inner = (xyxy > 0) & (xyxy < cameras.limits)
    xyxy = xyxy - is_inner * (excess_slopes(extent) @ habits[..., None])[..., 0]
    direction = np.array([fit.direction_sigma_rad for fit in fits])[numbers]
    shift_px = direction[:, None] * cameras.lenses.K[:, [0, 1], [0, 1]]
    excess_px = extent * np.array([fit.habit_sigma for fit in fits])[numbers, None]
    is_hidden = (hidden + HIDDEN_SHARE).clip(max=MAX_HIDDEN_SHARE)[:, None]
    hidden_odds = is_hidden / (1 - is_hidden) * np.sqrt(2 * np.pi) * sigma_px / sides
    sigma_px = np.hypot(sigma_px, depths_px)
    later_s = (stamps_ns - hypotheses.boxes.measured_ns[rows]) * 1e-9
    return MeasuredEdges(rows, cameras, xyxy, sigma_px, shift_px, excess_px, hidden_odds, later_s)


def excess_slopes(extent: F64) -> F64:
    """(P, 4, 4) derivatives of left, top, right, bottom of 2D boxes (width, height: (P, 2)) by `EdgeHabits`."""
    slopes = np.zeros((len(extent), 4, 4))
    slopes[:, 0, 0], slopes[:, 2, 0] = -extent[:, 0], extent[:, 0]
    slopes[:, 1, 1], slopes[:, 3, 2] = -extent[:, 1], extent[:, 1]
    slopes[..., 3] = -1.0, -1.0, 1.0, 1.0
    return slopes


def are_crowded(xyxy: F32) -> Bools:
    """(N, 4) whether the left, top, right and bottom edges of 2D boxes (N, 4) of one image lie in another of them."""
    low, high = xyxy[:, None, :2], xyxy[:, None, 2:]
    shared = np.minimum(high, xyxy[None, :, 2:]) - np.maximum(low, xyxy[None, :, :2])  # (N, N, 2) overlaps in x and y
    is_beside = (shared > MIN_CROWDED_SHARE * (high - low))[..., ::-1]
    others = ~np.eye(len(xyxy), dtype=np.bool_)[..., None]
    crowded = [
        (others & is_beside & (xyxy[None, :, :2] < edge) & (edge < xyxy[None, :, 2:])).any(1) for edge in (low, high)
    ]
    return np.concatenate(crowded, 1)
