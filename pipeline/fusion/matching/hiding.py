"""Which boxes stand behind others in an image, and what of them is left to see.

Two boxes on the ground that do not overlap can be parted by a line along a side of one of them. The one on the
camera's side of that line is in front: exact for boxes, where a comparison of distances is wrong beside long ones (a
bus along the road, and a pedestrian beside its middle).
"""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.detections import Boxes3D
from pipeline.core.geometry.boxes import box_corners
from pipeline.fusion.matching.groups import pairs_within
from pipeline.fusion.matching.in_view import InView

__all__ = ["hidden_parts"]

MAX_COVERS = 8
"""Of more boxes in front of one, those that cover most of it count."""


def hidden_parts(boxes: Boxes3D, seen: InView, positions_site: F64) -> tuple[F32, F32]:
    """How much of each rectangle is covered by boxes in front of it.

    Args:
        boxes: N boxes in the site frame.
        seen: P of them in images.
        positions_site: (C, 3) where the cameras stand, metres.

    Returns:
        (P,) share of the rectangle that nearer ones cover; (P, 4) the smallest rectangle around the rest, in pixels,
        the rectangle itself where nothing is left.
    """
    share, rest = np.zeros(len(seen), np.float32), seen.xyxy.copy()
    back, front = pairs_within(seen.cameras, seen.cameras)
    low = np.maximum(seen.xyxy[back, :2], seen.xyxy[front, :2])
    high = np.minimum(seen.xyxy[back, 2:], seen.xyxy[front, 2:])
    overlap = ((high > low).all(1) & (back != front)).nonzero()[0]
    nearer = overlap[_is_nearer(boxes, seen, front[overlap], back[overlap], positions_site)]
    if not len(nearer):
        return share, rest
    back, covers = back[nearer], np.concatenate([low[nearer], high[nearer]], 1).astype(np.float64)
    area = (covers[:, 2] - covers[:, 0]) * (covers[:, 3] - covers[:, 1])
    starts = np.flatnonzero(np.diff(back, prepend=-1))
    targets, counts = back[starts], np.diff(starts, append=len(back))
    if counts.max() > MAX_COVERS:
        covers = covers[np.lexsort([-area, back])]
    place = np.arange(len(back)) - np.repeat(starts, counts)
    kept = place < MAX_COVERS
    own = seen.xyxy[targets].astype(np.float64)
    table = np.tile(own[:, None, [0, 1, 0, 1]], (1, min(int(counts.max()), MAX_COVERS), 1))  # without area
    table[np.repeat(np.arange(len(targets)), counts)[kept], place[kept]] = covers[kept]
    share[targets], rest[targets] = _uncovered(own, table)
    return share, rest


def _is_nearer(boxes: Boxes3D, seen: InView, first: I64, second: I64, positions_site: F64) -> Bools:
    """(Q,) whether the box of row `first` of `seen` stands in front of that of row `second`."""
    rows, others = seen.rows[np.concatenate([first, second])], seen.rows[np.concatenate([second, first])]
    camera = positions_site[np.tile(seen.cameras[first], 2), :2]
    own_side, other_side = _sides(boxes, rows, others, camera)
    q = len(first)
    is_first, is_second = own_side[:q] | other_side[q:], own_side[q:] | other_side[:q]
    by_distance = seen.ranges_m[first] < seen.ranges_m[second]
    return np.where(is_first == is_second, by_distance, is_first)


def _sides(boxes: Boxes3D, rows: I64, others: I64, camera: F64) -> tuple[Bools, Bools]:
    """Whether a side of the boxes `rows` (Q,) parts them from the boxes `others` (Q,), as seen from above.

    Returns:
        (Q,) whether one does with the camera (Q, 2) on the box's own side, and (Q,) on the other's.
    """
    flat = box_corners(boxes.centers, boxes.sizes, boxes.yaws)[:, :4, :2]
    cos, sin, half = np.cos(boxes.yaws)[rows, None], np.sin(boxes.yaws)[rows, None], boxes.sizes[rows, :2] / 2
    x, y = np.moveaxis(
        np.concatenate([flat[others], camera[:, None]], 1) - boxes.centers[rows, None, :2], -1, 0
    )  # (Q, 5): four corners and the camera
    along, across = x * cos + y * sin, y * cos - x * sin
    reach = np.stack([along, -along, across, -across], 1) - half[:, [0, 0, 1, 1], None]
    parted, beyond = reach[..., :4].min(2) >= 0, reach[..., 4] >= 0
    return np.any(parted & ~beyond, axis=1), np.any(parted & beyond, axis=1)


def _uncovered(own: F64, covers: F64) -> tuple[F64, F64]:
    """Covered share (A,) of rectangles (A, 4) under others (A, k, 4) within them, and rectangle around the rest."""
    edges_x = np.sort(np.concatenate([own[:, [0, 2]], covers[..., 0], covers[..., 2]], 1), 1)
    edges_y = np.sort(np.concatenate([own[:, [1, 3]], covers[..., 1], covers[..., 3]], 1), 1)
    in_x = (covers[..., :1] <= edges_x[:, None, :-1]) & (edges_x[:, None, 1:] <= covers[..., 2:3])
    in_y = (covers[..., 1:2] <= edges_y[:, None, :-1]) & (edges_y[:, None, 1:] <= covers[..., 3:])
    areas = np.diff(edges_y)[:, :, None] * np.diff(edges_x)[:, None, :]
    free = (areas > 0) & ~np.any(in_y[..., :, None] & in_x[..., None, :], axis=1)
    whole = (own[:, 2] - own[:, 0]) * (own[:, 3] - own[:, 1])
    share = 1.0 - np.clip((areas * free).sum((1, 2)) / whole, 0.0, 1.0)
    columns, rows = np.any(free, axis=1), np.any(free, axis=2)
    rest = np.stack(
        [
            np.where(columns, edges_x[:, :-1], np.inf).min(1),
            np.where(rows, edges_y[:, :-1], np.inf).min(1),
            np.where(columns, edges_x[:, 1:], -np.inf).max(1),
            np.where(rows, edges_y[:, 1:], -np.inf).max(1),
        ],
        1,
    )
    return share, np.where(columns.any(1)[:, None], rest, own)
