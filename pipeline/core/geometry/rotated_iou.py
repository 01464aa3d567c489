"""Intersection over union of upright boxes of any yaw: of their ground (bird's eye) and of their volume."""

from typing import NamedTuple, Protocol

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.geometry.rotated_iou_kernels import shared_grounds

__all__ = ["BoxArrays", "Ious", "OrientedBoxes", "ious", "pair_ious", "shared_ground"]

BLOCK = 1 << 14
"""Pairs that are compared at once: memory is bounded."""

ROUNDING = 16 * np.finfo(np.float64).eps
"""Boxes that share less than this part of their ground share nothing: sums of the size of a box are not finer."""


class OrientedBoxes(Protocol):
    """Boxes that stand upright: `Boxes3D`, `TruthBoxes3D`, `BoxArrays`."""

    @property
    def centers(self) -> F64:
        """(N, 3) centre of the box, metres."""
        ...

    @property
    def sizes(self) -> F64:
        """(N, 3) length, width, height, metres."""
        ...

    @property
    def yaws(self) -> F64:
        """(N,) about +z, radians; any turn."""
        ...


class BoxArrays(NamedTuple):
    """Bare `OrientedBoxes`, to select or join the rows of others."""

    centers: F64
    sizes: F64
    yaws: F64


class Ious(NamedTuple):
    """Intersection over union in [0, 1], of pairs (P,) or of each box with each (N, M).

    Attributes:
        bev: Of the ground that the boxes cover, whatever their height ("bird's eye view").
        volume: Of the boxes.
    """

    bev: F64
    volume: F64


def ious(first: OrientedBoxes, second: OrientedBoxes) -> Ious:
    """IoU of each of N boxes with each of M, (N, M); only pairs that are near each other are clipped.

    See `pair_ious`.
    """
    reach_m = [np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2 for boxes in (first, second)]
    with np.errstate(invalid="ignore", over="ignore"):
        gap_m = first.centers[:, None, :2] - second.centers[None, :, :2]
        is_near = np.hypot(gap_m[..., 0], gap_m[..., 1]) <= reach_m[0][:, None] + reach_m[1]
    rows, columns = np.nonzero(is_near)
    near = pair_ious(
        BoxArrays(first.centers[rows], first.sizes[rows], first.yaws[rows]),
        BoxArrays(second.centers[columns], second.sizes[columns], second.yaws[columns]),
    )
    found = Ious(np.zeros(is_near.shape), np.zeros(is_near.shape))
    found.bev[rows, columns], found.volume[rows, columns] = near
    return found


def pair_ious(first: OrientedBoxes, second: OrientedBoxes) -> Ious:
    """IoU of the P boxes of `first` with those of the same rows of `second`, (P,).

    Exact up to rounding; 0, never NaN, if one of the two has no extent or is not finite. Boxes without height have a
    bird's eye IoU all the same.
    """
    shared_m2 = shared_ground(first, second)
    with np.errstate(invalid="ignore", over="ignore"):
        ground_m2 = [boxes.sizes[:, 0] * boxes.sizes[:, 1] for boxes in (first, second)]
        height_m, other_height_m = first.sizes[:, 2], second.sizes[:, 2]
        rise_m = second.centers[:, 2] - first.centers[:, 2]
        top_m = np.minimum(height_m / 2, rise_m + other_height_m / 2)
        bottom_m = np.maximum(-height_m / 2, rise_m - other_height_m / 2)
        common_m = np.clip(top_m - bottom_m, 0.0, np.minimum(height_m, other_height_m))
        volumes_m3 = ground_m2[0] * height_m, ground_m2[1] * other_height_m
        shared_m3 = np.where((height_m > 0) & (other_height_m > 0), shared_m2 * common_m, 0.0)
        return Ious(_iou(shared_m2, *ground_m2), _iou(shared_m3, *volumes_m3))


def shared_ground(first: OrientedBoxes, second: OrientedBoxes) -> F64:
    """(P,) square metres that each box of `first` has in common with that of `second` in the same row, seen from above.

    0 if one of the two has no ground or is not finite.
    """
    shared_m2 = np.empty(len(first.yaws))
    for start in range(0, len(shared_m2), BLOCK):
        rows = slice(start, start + BLOCK)
        with np.errstate(invalid="ignore"):
            yaws, turn = first.yaws[rows], second.yaws[rows] - first.yaws[rows]
            directions = np.cos(yaws), np.sin(yaws), np.cos(turn), np.sin(turn)
        shared_m2[rows] = shared_grounds(
            np.ascontiguousarray(first.centers[rows]),
            np.ascontiguousarray(first.sizes[rows]),
            np.ascontiguousarray(second.centers[rows]),
            np.ascontiguousarray(second.sizes[rows]),
            *directions,
            ROUNDING,
        )
    return shared_m2


def _iou(shared: F64, first: F64, second: F64) -> F64:
    union = first + second - shared
    is_sound = (shared > 0) & np.isfinite(union)
    return np.where(is_sound, shared / np.where(is_sound, union, 1.0), 0.0)
