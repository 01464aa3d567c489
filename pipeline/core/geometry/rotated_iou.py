"""Intersection over union of upright boxes of any yaw: of their ground (bird's eye) and of their volume."""

from typing import NamedTuple, Protocol

import numpy as np

from lidcam.pipeline.core.arrays import F64, Indices

BLOCK = 1 << 12
"""Pairs that are compared at once: memory is bounded."""

ROUNDING = 16 * np.finfo(np.float64).eps
"""Boxes that share less than this part of their ground share nothing: sums of the size of a box are not finer."""

_ALONG, _ACROSS = np.array([1.0, -1, -1, 1, 1]), np.array([1.0, 1, -1, -1, 1])
"""The corners of a rectangle, counter-clockwise, and the first once more, in halves of its length and width."""


class OrientedBoxes(Protocol):
    """Boxes that stand upright: `Boxes3D`, `TruthBoxes3D`, `BoxArrays`."""

    @property
    def centers(self) -> F64:
        """(N, 3) centre of the box, metres."""

    @property
    def sizes(self) -> F64:
        """(N, 3) length, width, height, metres."""

    @property
    def yaws(self) -> F64:
        """(N,) about +z, radians; any turn."""


class BoxArrays(NamedTuple):
    """Bare `OrientedBoxes`, to select or join the rows of others."""

    centers: F64
    sizes: F64
    yaws: F64

    @classmethod
    def of(cls, boxes: OrientedBoxes, rows: Indices | slice) -> "BoxArrays":
        """These rows of boxes."""
        return cls(boxes.centers[rows], boxes.sizes[rows], boxes.yaws[rows])


class Ious(NamedTuple):
    """Intersection over union in [0, 1], of pairs (P,) or of each box with each (N, M)."""

    bev: F64  # Of the ground that the boxes cover, whatever their height ("bird's eye view")
    volume: F64  # Of the boxes


def ious(first: OrientedBoxes, second: OrientedBoxes) -> Ious:
    """IoU of each of N boxes with each of M, (N, M); only pairs that are near each other are clipped.

    See `pair_ious`.
    """
    reach_m = [np.hypot(boxes.sizes[:, 0], boxes.sizes[:, 1]) / 2 for boxes in (first, second)]
    with np.errstate(invalid="ignore", over="ignore"):
        gap_m = first.centers[:, None, :2] - second.centers[None, :, :2]
        is_near = np.hypot(gap_m[..., 0], gap_m[..., 1]) <= reach_m[0][:, None] + reach_m[1]
    rows, columns = np.nonzero(is_near)
    near = pair_ious(BoxArrays.of(first, rows), BoxArrays.of(second, columns))
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
    with np.errstate(invalid="ignore", over="ignore"):
        for start in range(0, len(shared_m2), BLOCK):
            rows = slice(start, start + BLOCK)
            shared_m2[rows] = _shared_ground(BoxArrays.of(first, rows), BoxArrays.of(second, rows))
    return shared_m2


def _shared_ground(first: BoxArrays, second: BoxArrays) -> F64:
    """See `shared_ground`.

    The integral over x, in the frame of the first box, of the height y that lies in both rectangles. Above each x, the
    second rectangle reaches from one of its edges up to another; both are cut off where the first one ends. So what its
    edges contribute, each with the sign of its direction, adds up to the area. No polygon is made whose corners could
    be confused where edges and corners meet: the area is continuous in what is given.
    """
    gap, yaws = second.centers[:, :2] - first.centers[:, :2], first.yaws
    cos, sin, turn = np.cos(yaws)[:, None], np.sin(yaws)[:, None], (second.yaws - yaws)[:, None]
    turn_cos, turn_sin = np.cos(turn), np.sin(turn)
    along, across = second.sizes[:, :1] / 2 * _ALONG, second.sizes[:, 1:2] / 2 * _ACROSS
    x = gap[:, :1] * cos + gap[:, 1:] * sin + along * turn_cos - across * turn_sin
    y = gap[:, 1:] * cos - gap[:, :1] * sin + along * turn_sin + across * turn_cos
    half_length, half_width = first.sizes[:, :1] / 2, first.sizes[:, 1:2] / 2
    x, next_x, y, next_y = x[:, :-1], x[:, 1:], y[:, :-1], y[:, 1:]
    way_x, way_y = np.where(next_x == x, 1.0, next_x - x), next_y - y
    left, right = (value.clip(-half_length, half_length) for value in (x, next_x))
    left_y = y + ((left - x) / way_x).clip(0.0, 1.0) * way_y
    right_y = next_y - ((next_x - right) / way_x).clip(0.0, 1.0) * way_y
    area = ((left - right) * _mean_clipped(left_y, right_y, half_width)).sum(1)
    ground_m2 = [boxes.sizes[:, 0] * boxes.sizes[:, 1] for boxes in (first, second)]
    has_ground = (first.sizes[:, :2] > 0).all(1) & (second.sizes[:, :2] > 0).all(1)
    area = np.minimum(area, np.minimum(*ground_m2))
    return np.where(has_ground & (area > ROUNDING * (ground_m2[0] + ground_m2[1])), area, 0.0)


def _mean_clipped(start: F64, end: F64, limit: F64) -> F64:
    """Mean of the numbers from `start` to `end`, each of them clipped to -`limit` .. `limit`."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    within_low, within_high = low.clip(-limit, limit), high.clip(-limit, limit)
    above = np.maximum(high, limit) - np.maximum(low, limit)
    below = np.minimum(high, -limit) - np.minimum(low, -limit)
    whole = (within_high - within_low) * (within_high + within_low) / 2 + limit * (above - below)
    return np.where(high > low, whole / np.where(high > low, high - low, 1.0), within_low)


def _iou(shared: F64, first: F64, second: F64) -> F64:
    union = first + second - shared
    is_sound = (shared > 0) & np.isfinite(union)
    return np.where(is_sound, shared / np.where(is_sound, union, 1.0), 0.0)
