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
    found = 0
    for side in range(4):
        sign, axis = 1 - side % 2 * 2, side // 2
        is_parted = True
        for k in range(5):  # four corners of the other one, and the camera
            away_x = (corners[other, k, 0] if k < 4 else positions[camera, 0]) - x
            away_y = (corners[other, k, 1] if k < 4 else positions[camera, 1]) - y
            along = away_x * cos + away_y * sin if axis == 0 else away_y * cos - away_x * sin
            is_beyond = sign * along - halves[own, axis] >= 0
            if k < 4:
                is_parted = is_parted and is_beyond
            elif is_parted:
                found |= 2 if is_beyond else 1
    return found


@inlined
def _covered(own: F64, covers: F64, count: int, xs: F64, ys: F64, rest: F32) -> float:
    """Covered share of a rectangle under others within it; the rectangle around the rest goes to `rest`, if any."""
    ends = 2 * count + 2
    xs[0], xs[1], ys[0], ys[1] = own[0], own[2], own[1], own[3]
    for k in range(count):
        xs[2 * k + 2], xs[2 * k + 3] = covers[k, 0], covers[k, 2]
        ys[2 * k + 2], ys[2 * k + 3] = covers[k, 1], covers[k, 3]
    xs[:ends].sort()
    ys[:ends].sort()
    left, top, right, bottom, free = np.inf, np.inf, -np.inf, -np.inf, 0.0
    for row in range(ends - 1):
        for column in range(ends - 1):
            area = (ys[row + 1] - ys[row]) * (xs[column + 1] - xs[column])
            is_free = area > 0
            for k in range(count):
                in_x = covers[k, 0] <= xs[column] and xs[column + 1] <= covers[k, 2]
                is_free = is_free and not (in_x and covers[k, 1] <= ys[row] and ys[row + 1] <= covers[k, 3])
            if is_free:
                free += area
                left, right = min(left, xs[column]), max(right, xs[column + 1])
                top, bottom = min(top, ys[row]), max(bottom, ys[row + 1])
    if left < right:
        rest[0], rest[1], rest[2], rest[3] = left, top, right, bottom
    share: float = free / ((own[2] - own[0]) * (own[3] - own[1]))
    return 1.0 - min(max(share, 0.0), 1.0)


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
    xs, ys = np.empty(2 * max_covers + 2), np.empty(2 * max_covers + 2)
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
                ahead = _parted(rows[front], row, camera, corners, turns, halves, positions)
                behind = _parted(row, rows[front], camera, corners, turns, halves, positions)
                is_ahead, is_behind = ahead & 1 or behind & 2, behind & 1 or ahead & 2
                by_range = ranges_m[front] < ranges_m[back]
                if by_range if bool(is_ahead) == bool(is_behind) else is_ahead:
                    # Sorted by what they cover, the largest first; of those that cover alike, in their order.
                    place = count
                    area = (np.float64(right) - left) * (np.float64(bottom) - top)
                    while place > 0 and areas[place - 1] < area:
                        areas[place] = areas[place - 1]
                        covers[place] = covers[place - 1]
                        place -= 1
                    areas[place] = area
                    covers[place, 0], covers[place, 1], covers[place, 2], covers[place, 3] = left, top, right, bottom
                    count = min(count + 1, max_covers)
            front += 1
        if count:
            for k in range(4):
                own[k] = xyxy[back, k]
            share[back] = _covered(own, covers, count, xs, ys, rest[back])
    return share, rest
