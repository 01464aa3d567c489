"""The loops of `clusters.py`: points averaged by cells, and cells linked."""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["ascending", "average", "cell_keys", "levels", "link"]


RESOLUTION_PER_M = 8192.0
"""Coordinates are rounded to this fraction of a metre (0.12 mm), so float64 adds up a million of them exactly."""

DIGIT_BITS = 11
DIGITS = 1 << DIGIT_BITS
"""Keys are sorted by so many bits at a time."""

FURTHEST_CELL = 2.0**61
"""Cells are counted up to here, and up to `FURTHEST_BUCKET` in the search: no float64 beyond fits into an int64."""

FURTHEST_BUCKET = 2.0**40

ROOM = 1.0 + 1e-6
"""Edge of a bucket, in the longest distance of its level: no rounding puts near points two buckets apart."""


@inlined
def _exact(value: float) -> float:
    exact: float = np.rint(value * RESOLUTION_PER_M) / RESOLUTION_PER_M
    return exact


@compiled("int64[::1](float64[::1], float64, float64[::1])")
def levels(values: F64, share: float, series: F64) -> I64:
    """(N,) the last step of a rising series that a share of each value reaches; 0 before the first."""
    found = np.empty(len(values), np.int64)
    for i in range(len(values)):
        level = 0
        while level + 1 < len(series) and share * values[i] >= series[level + 1]:
            level += 1
        found[i] = level
    return found


@compiled("int64[::1](int64[::1])")
def ascending(keys: I64) -> I64:
    """(N,) rows in order of their keys as unsigned numbers, those of equal keys in their own order."""
    count, used = len(keys), 0
    for key in keys:
        used |= key
    rows, other_rows = np.empty(count, np.int64), np.empty(count, np.int64)
    old_keys, new_keys = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        rows[i], old_keys[i] = i, keys[i]
    place = np.empty(DIGITS, np.int64)
    shift = 0
    while shift < 64 and used >> shift != 0:
        for digit in range(DIGITS):
            place[digit] = 0
        for key in old_keys:
            place[(key >> shift) & (DIGITS - 1)] += 1
        before = 0
        for digit in range(DIGITS):
            before += place[digit]
            place[digit] = before - place[digit]
        for i in range(count):
            digit = (old_keys[i] >> shift) & (DIGITS - 1)
            other_rows[place[digit]] = rows[i]
            new_keys[place[digit]] = old_keys[i]
            place[digit] += 1
        rows, other_rows, old_keys, new_keys = other_rows, rows, new_keys, old_keys
        shift += DIGIT_BITS
    return rows


@compiled("int64[::1](float64[:, ::1], int64[::1], float64[::1], int64[::1], int64)")
def cell_keys(points: F64, level: I64, edges_m: F64, group: I64, groups: int) -> I64:
    """(N,) a number for the cell of each point: rising by level, group and place along x, y, z.

    Args:
        points: (N, 3) metres.
        level: (N,) row of the edge of the cells at each point.
        edges_m: Of the cells.
        group: (N,) from 0.
        groups: Their number.
    """
    count = len(points)
    cell, low, high = np.empty((count, 3), np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(count):
        edge_m = edges_m[level[i]]
        for axis in range(3):
            place = np.floor(_exact(points[i, axis]) / edge_m)
            now = int(min(max(place, -FURTHEST_CELL), FURTHEST_CELL))
            cell[i, axis] = now
            if i == 0 or now < low[axis]:
                low[axis] = now
            if i == 0 or now > high[axis]:
                high[axis] = now
    keys = np.empty(count, np.int64)
    for i in range(count):
        key = level[i] * groups + group[i]
        for axis in range(3):
            key = key * (high[axis] - low[axis] + 1) + (cell[i, axis] - low[axis])
        keys[i] = key
    return keys


@compiled(
    "Tuple((int64, float64[:, ::1], float64[::1], int64[::1], int64[::1], int64[::1]))"
    "(float64[:, ::1], float64[::1], int64[::1], int64[::1])"
)
def average(points: F64, distance_m: F64, keys: I64, rows: I64) -> tuple[int, F64, F64, I64, I64, I64]:
    """The number of cells, and the fields of `clusters.Cells` with room behind them.

    Args:
        points: (N, 3) metres.
        distance_m: (N,) metres.
        keys: (N,) number of each point's cell.
        rows: (N,) of the points in the order of these.
    """
    count = len(points)
    means, least_m, cell_of_point = np.empty((count, 3)), np.empty(count), np.empty(count, np.int64)
    counts, first = np.empty(count, np.int64), np.empty(count, np.int64)
    cell, before = -1, 0
    for row in rows:
        if cell < 0 or keys[row] != before:
            cell += 1
            before = keys[row]
            counts[cell], first[cell], least_m[cell] = 0, row, distance_m[row]
            for axis in range(3):
                means[cell, axis] = -0.0  # which adds nothing, not even a sign
        cell_of_point[row] = cell
        counts[cell] += 1
        if distance_m[row] < least_m[cell]:
            least_m[cell] = distance_m[row]
        for axis in range(3):
            means[cell, axis] += _exact(points[row, axis])
    for now in range(cell + 1):
        for axis in range(3):
            means[now, axis] /= counts[now]
    return cell + 1, means, least_m, counts, first, cell_of_point


@inlined
def _root(parent: I64, row: int) -> int:
    while parent[row] != row:
        parent[row] = parent[parent[row]]
        row = parent[row]
    return row


@compiled("void(float64[:, ::1], float64[::1], int64[::1], int64[::1], int64, int64, float64, int64[::1], int64[::1])")
def _link_level(
    points: F64,
    distance_m: F64,
    level: I64,
    rows: I64,
    count: int,
    lowest: int,
    edge_m: float,
    starts: I64,
    parent: I64,
) -> None:
    """Link the points of one level with each other and with those of the levels above.

    They lie in buckets of a square grid, which has more squares than there are buckets: after the last bucket comes the
    first one again, and what lies in it by chance is too far away.

    Args:
        points: Of all levels.
        distance_m: Of all levels.
        level: Of each point.
        rows: Of the points of this level and above, rising; the first `count` are used.
        count: Number of these.
        lowest: This level.
        edge_m: At least the longest distance of this level.
        starts: Room for the first point of each bucket, a power of two and one.
        parent: A point of the same part; changed.
    """
    buckets = len(starts) - 1
    low_x, low_y, high_y = np.inf, np.inf, -np.inf
    for i in range(count):
        row = rows[i]
        low_x, low_y, high_y = min(low_x, points[row, 0]), min(low_y, points[row, 1]), max(high_y, points[row, 1])
    width = int(min((high_y - low_y) / edge_m, FURTHEST_BUCKET)) + 3
    bucket = np.empty(count, np.int64)
    for k in range(buckets + 1):
        starts[k] = 0
    for i in range(count):
        column = int(min((points[rows[i], 0] - low_x) / edge_m, FURTHEST_BUCKET))
        line = int(min((points[rows[i], 1] - low_y) / edge_m, FURTHEST_BUCKET))
        bucket[i] = (column * width + line) & (buckets - 1)
        starts[bucket[i]] += 1
    for k in range(1, buckets + 1):
        starts[k] += starts[k - 1]
    near, near_row = np.empty((count, 4)), np.empty(count, np.int64)  # bucket after bucket
    for i in range(count - 1, -1, -1):
        starts[bucket[i]] -= 1
        place = starts[bucket[i]]
        near_row[place] = rows[i]
        near[place, 0], near[place, 1], near[place, 2] = points[rows[i], 0], points[rows[i], 1], points[rows[i], 2]
        near[place, 3] = distance_m[rows[i]]

    for i in range(count):
        row = rows[i]
        if level[row] != lowest:
            continue
        x, y, z, own_m = points[row, 0], points[row, 1], points[row, 2], distance_m[row]
        for column in range(-1, 2):
            first = (bucket[i] + column * width - 1) & (buckets - 1)
            for is_rest in range(2):  # three buckets in a row, of which some may be the first of all
                start = 0 if is_rest else starts[first]
                stop = starts[max(first + 3 - buckets, 0)] if is_rest else starts[min(first + 3, buckets)]
                for place in range(start, stop):
                    dx, dy, dz = x - near[place, 0], y - near[place, 1], z - near[place, 2]
                    link_m = min(own_m, near[place, 3])
                    if dx * dx + dy * dy + dz * dz <= link_m * link_m:
                        other = near_row[place]
                        if other > row or level[other] != lowest:
                            own, other = _root(parent, row), _root(parent, other)
                            parent[max(own, other)] = min(own, other)


@compiled("Tuple((int64, int64[::1]))(float64[:, ::1], float64[::1], int64[::1], int64)")
def link(points: F64, distance_m: F64, level: I64, level_count: int) -> tuple[int, I64]:
    """Connected parts of the graph of points at most the smaller of their distances apart.

    Searched level by level, so that the wide search of far points leaves out the near ones: each pair is found at the
    level of its smaller distance, which includes both.

    Args:
        points: (N, 3) metres, at least one.
        distance_m: (N,) positive.
        level: (N,) step of each distance in a rising series.
        level_count: Number of levels.

    Returns:
        The number of parts, and (N,) the part of each point, numbered in order of their first point.
    """
    count = len(points)
    parent, rows = np.empty(count, np.int64), np.empty(count, np.int64)
    for row in range(count):
        parent[row] = row
    buckets = 64
    while buckets < count:
        buckets *= 2
    starts = np.empty(buckets + 1, np.int64)
    for lowest in range(level_count):
        reach_m, above = 0.0, 0
        for row in range(count):
            if level[row] >= lowest:
                rows[above] = row
                above += 1
            if level[row] == lowest:
                reach_m = max(reach_m, distance_m[row])
        if reach_m > 0.0:
            _link_level(points, distance_m, level, rows, above, lowest, reach_m * ROOM, starts, parent)

    part, parts = np.empty(count, np.int64), 0
    for i in range(count):  # the root of a part is its first point
        root = _root(parent, i)
        if root == i:
            part[i] = parts
            parts += 1
        else:
            part[i] = part[root]
    return parts, part
