"""What covers each rectangle, compiled: one pass over the pairs of boxes in an image, in the memory of one box."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["uncovered_parts"]

_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))
_RECTANGLES = "Array(float32, 2, 'C', True)"


@inlined
def _parted(own: int, other: int, camera: int, corners: F64, turns: F64, halves: F64, positions: F64) -> int:
    """Whether a side of one box parts it from another: 1 with the camera on its own side, 2 on the other's, 3 both."""
    x, y, cos, sin = turns[own, 0], turns[own, 1], turns[own, 2], turns[own, 3]
    camera_x, camera_y = positions[camera, 0] - x, positions[camera, 1] - y
    low, high, found = (np.inf, np.inf), (-np.inf, -np.inf), 0
    for k in range(4):
        away_x, away_y = corners[other, k, 0] - x, corners[other, k, 1] - y
        along, across = away_x * cos + away_y * sin, away_y * cos - away_x * sin
        low, high = (min(low[0], along), min(low[1], across)), (max(high[0], along), max(high[1], across))
    place = camera_x * cos + camera_y * sin, camera_y * cos - camera_x * sin
    for axis in range(2):
        half = halves[own, axis]
        if low[axis] - half >= 0:
            found |= 2 if place[axis] - half >= 0 else 1
        if -high[axis] - half >= 0:
            found |= 2 if -place[axis] - half >= 0 else 1
    return found


@inlined
def _covered(own: F64, covers: F64, count: int, ends: F64, rest: F32) -> float:
    """Covered share of a rectangle under others within it; the rectangle around the rest goes to `rest`, if any.

    `ends` is space for the places, across and down, where a rectangle begins or ends, in rising order: between two of
    them everything is either covered or free.
    """
    last = 2 * count + 1
    for axis in range(2):
        ends[axis, 0], ends[axis, 1] = own[axis], own[axis + 2]
        for k in range(2 * count):
            value, place = covers[k // 2, axis + k % 2 * 2], k + 2
            while place > 0 and ends[axis, place - 1] > value:
                ends[axis, place] = ends[axis, place - 1]
                place -= 1
            ends[axis, place] = value
    left, top, right, bottom, free = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for row in range(last):
        y, next_y = ends[1, row], ends[1, row + 1]
        for column in range(last):
            x, next_x = ends[0, column], ends[0, column + 1]
            area = (next_y - y) * (next_x - x)
            is_free = area > 0
            for k in range(count):
                in_x, in_y = covers[k, 0] <= x and next_x <= covers[k, 2], covers[k, 1] <= y and next_y <= covers[k, 3]
                is_free = is_free and not (in_x and in_y)
            if is_free:
                free += area
                left, right, top, bottom = min(left, x), max(right, next_x), min(top, y), max(bottom, next_y)
    if left < right:
        rest[0], rest[1], rest[2], rest[3] = left, top, right, bottom
    return 1.0 - float(min(max(free / ((own[2] - own[0]) * (own[3] - own[1])), 0.0), 1.0))


@compiled(
    "Tuple((float32[::1], float32[:, ::1]))"
    f"({_RECTANGLES}, {_ROWS}, {_ROWS}, {_LIST}, {_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, int64)"
)
def uncovered_parts(
    xyxy: F32,
    cameras: I64,
    rows: I64,
    ranges_m: F64,
    corners: F64,
    turns: F64,
    halves: F64,
    positions: F64,
    max_covers: int,
) -> tuple[F32, F32]:
    """How much of each rectangle nearer ones of the same image cover, and the smallest rectangle around the rest.

    Args:
        xyxy: (P, 4) rectangles, pixels.
        cameras: (P,) their cameras, rising.
        rows: (P,) their boxes.
        ranges_m: (P,) distance of the box's centre from the camera.
        corners: (N, 4, 2) corners of the boxes on the ground, metres.
        turns: (N, 4) x and y of their centres, cosine and sine of their yaws.
        halves: (N, 2) half of their lengths and widths, metres.
        positions: (C, 2) where the cameras stand, metres.
        max_covers: Of more boxes in front of one, the so many that cover most of it count.

    Returns:
        (P,) shares, and (P, 4) rectangles, those themselves where nothing is left.
    """
    share, rest = np.zeros(len(rows), np.float32), xyxy.copy()
    own, covers, areas = np.empty(4), np.empty((max_covers + 1, 4)), np.empty(max_covers + 1)
    ends, sides = np.empty((2, 2 * max_covers + 2)), np.empty(2, np.int64)
    start = 0
    for back in range(len(rows)):
        if cameras[back] != cameras[start]:
            start = back
        count, camera, row = 0, cameras[back], rows[back]
        front = start
        while front < len(rows) and cameras[front] == camera:
            left, top = max(xyxy[back, 0], xyxy[front, 0]), max(xyxy[back, 1], xyxy[front, 1])
            right, bottom = min(xyxy[back, 2], xyxy[front, 2]), min(xyxy[back, 3], xyxy[front, 3])
            if front != back and right > left and bottom > top:
                for turn in range(2):
                    one, other = (rows[front], row) if turn == 0 else (row, rows[front])
                    sides[turn] = _parted(one, other, camera, corners, turns, halves, positions)
                is_ahead, is_behind = sides[0] & 1 or sides[1] & 2, sides[1] & 1 or sides[0] & 2
                by_range = ranges_m[front] < ranges_m[back]
                if by_range if bool(is_ahead) == bool(is_behind) else is_ahead:
                    # Sorted by what they cover, the largest first; of those that cover alike, in their order.
                    place = count
                    area = (np.float64(right) - left) * (np.float64(bottom) - top)
                    while place > 0 and areas[place - 1] < area:
                        areas[place] = areas[place - 1]
                        for k in range(4):
                            covers[place, k] = covers[place - 1, k]
                        place -= 1
                    areas[place] = area
                    covers[place, 0], covers[place, 1], covers[place, 2], covers[place, 3] = left, top, right, bottom
                    count = min(count + 1, max_covers)
            front += 1
        if count:
            for k in range(4):
                own[k] = xyxy[back, k]
            share[back] = _covered(own, covers, count, ends, rest[back])
    return share, rest
