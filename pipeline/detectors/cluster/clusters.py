"""Thinning and range-aware single-linkage clustering of a lidar cloud.

Two points are linked if they are nearer than a distance that grows with their range, because points thin out with
range. The caller may scale down heights, so that a roof is linked to its bonnet and the rings of a sparse lidar to each
other, but a tree not to the car below.

The result does not depend on the order of the points: coordinates are rounded to a binary fraction of a metre, which
makes their sums exact, and all further steps are ordered by grid cell.
"""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.compiled import compiled, inlined

HEIGHT_WEIGHT = 0.5
"""Weight of a vertical metre in link distances; a horizontal metre counts 1."""

LINK_CELL_SHARE = 0.6
"""Edge of the linked cells, as a share of the link distance; finer cells cost more and change little."""

LEVEL_GROWTH = 1.5
"""Ratio of the edges of neighbouring levels of the grid."""

SEARCH_GROWTH = 4.0
"""Ratio of the distances of neighbouring levels in the search: most clouds have one, as searching each takes longer
than searching some points too many; but one far point is not to make all others look far."""

RESOLUTION_PER_M = 8192.0
"""Steps of rounded coordinates in a metre (0.12 mm each), so float64 adds up a million of them exactly."""

MAX_CELL = 2.0**61
"""Maximum number of a cell along an axis: no float64 beyond fits into an int64."""

MAX_BUCKET = 2.0**40
"""Maximum number of a bucket along an axis of the search."""

BUCKETS_ACROSS = 1.0
"""Buckets in a link distance; many small ones take longer than some points too many."""

ROOM = 1.0 + 1e-6
"""Factor on the distance of the search, more than any rounding takes."""

SPREAD = np.uint64(0x9E3779B97F4A7C15)
"""Factor after which numbers differ in their upper bits (D. E. Knuth: The art of computer programming, vol. 3, 6.4)."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Points grouped by the cells of a grid, in order of cell."""

    means: F64  # (M, 3) float64 mean of each cell's points, metres
    distance_m: F64  # (M,) float64 smallest link distance of each cell's points
    counts: I64  # (M,) int64 number of points in each cell
    first: I64  # (M,) int64 first point of each cell
    cell_of_point: I64  # (N,) int64 cell of each point


def thin_points(points: F64, distance_m: F64, share: float, group: I64 | None = None) -> Cells:
    """Group at least one point by the cells of a grid of varying size.

    Args:
        points: (N, 3) metres.
        distance_m: (N,) link distance at each point, positive.
        share: Edge of the cell at a point, as a share of this distance; rounded down to the next of a series of sizes.
        group: (N,) group of each point, from 0; different groups share no cell.
    """
    points = np.ascontiguousarray(points)
    group = np.zeros(len(points), np.int64) if group is None else group
    edges_m = _series(share * distance_m.min(), share * distance_m.max(), LEVEL_GROWTH)
    cell_of_point, first, keys = _grouped(points, distance_m, share, edges_m, group, int(group.max()) + 1)
    order = np.argsort(keys.view(np.uint64))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    cell_of_point = place[cell_of_point]
    return Cells(*_averaged(points, distance_m, cell_of_point, len(order)), first[order], cell_of_point)


def cluster_points(points: F64, link_distance_m: F64) -> tuple[int, I64]:
    """Split points into clusters further apart than the link distance.

    Points are grouped by cells of about half the link distance. Two cells are linked if the distance of their means is
    at most the smaller of their link distances.

    Args:
        points: (N, 3) metres.
        link_distance_m: (N,) link distance at each point, positive.

    Returns:
        The number of clusters, and the cluster of each point (N,), numbered in order of their first cell.
    """
    if not len(points):
        return 0, np.zeros(0, np.int64)
    cells = thin_points(points, link_distance_m, LINK_CELL_SHARE)
    series = _series(cells.distance_m.min(), cells.distance_m.max(), SEARCH_GROWTH)
    count, cluster_of_cell = _link(cells.means, cells.distance_m, series)
    return count, cluster_of_cell[cells.cell_of_point]


def _series(first: float, last: float, growth: float) -> F64:
    """A geometric series from `first` up to `last`."""
    steps = [first]
    while steps[-1] * growth <= last < np.inf:
        steps.append(first * growth ** len(steps))
    return np.array(steps)


@inlined
def _exact(value: float) -> float:
    exact: float = np.rint(value * RESOLUTION_PER_M) / RESOLUTION_PER_M
    return exact


@inlined
def _level(value: float, series: F64) -> int:
    """The last step of a rising series that a value reaches; 0 before the first."""
    level = 0
    while level + 1 < len(series) and value >= series[level + 1]:
        level += 1
    return level


@inlined
def _cell_keys(points: F64, distance_m: F64, share: float, edges_m: F64, group: I64, groups: int) -> I64:
    """(N,) a number for the cell of each point: rising by level, group and place along x, y, z; see `_grouped`."""
    count = len(points)
    cell, keys = np.empty((3, count), np.int64), np.empty(count, np.int64)
    for i in range(count):
        level = _level(share * distance_m[i], edges_m)
        keys[i], edge_m = level * groups + group[i], edges_m[level]
        for axis in range(3):
            place = np.floor(_exact(points[i, axis]) / edge_m)
            if not abs(place) < MAX_CELL:  # faster than `min` and `max`
                place = MAX_CELL if place > 0 else -MAX_CELL
            cell[axis, i] = int(place)
    for axis in range(3):
        along = cell[axis]
        low = high = along[0]
        for now in along:
            low, high = min(low, now), max(high, now)
        for i in range(count):
            keys[i] = keys[i] * (high - low + 1) + (along[i] - low)
    return keys


@compiled(
    "Tuple((int64[::1], int64[::1], int64[::1]))"
    "(float64[:, ::1], float64[::1], float64, float64[::1], int64[::1], int64)"
)
def _grouped(points: F64, distance_m: F64, share: float, edges_m: F64, group: I64, groups: int) -> tuple[I64, I64, I64]:
    """(N,) cell of each point, in order of their first points; and (M,) the first point and the key of each cell.

    The edge of a cell is the longest of `edges_m`, a rising series, that is no longer than the share of the distance.
    """
    count, keys = len(points), _cell_keys(points, distance_m, share, edges_m, group, groups)
    slots, shift = 64, np.uint64(58)
    runs = 1  # of points that follow each other in a cell
    for i in range(1, count):
        runs += keys[i] != keys[i - 1]
    while slots < 2 * runs:
        slots, shift = 2 * slots, shift - np.uint64(1)
    cell_in_slot = np.full(slots, -1, np.int32)
    cell_of_point, first, key_of_cell = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    cells = 0
    for i in range(count):
        if i > 0 and keys[i] == keys[i - 1]:  # as often as not
            cell_of_point[i] = cell_of_point[i - 1]
            continue
        slot = np.int64((np.uint64(keys[i]) * SPREAD) >> shift)
        while cell_in_slot[slot] >= 0 and key_of_cell[cell_in_slot[slot]] != keys[i]:
            slot = (slot + 1) & (slots - 1)
        if cell_in_slot[slot] < 0:
            cell_in_slot[slot], key_of_cell[cells], first[cells] = cells, keys[i], i
            cells += 1
        cell_of_point[i] = cell_in_slot[slot]
    return cell_of_point, first[:cells], key_of_cell[:cells]


@compiled("Tuple((float64[:, ::1], float64[::1], int64[::1]))(float64[:, ::1], float64[::1], int64[::1], int64)")
def _averaged(points: F64, distance_m: F64, cell_of_point: I64, cells: int) -> tuple[F64, F64, I64]:
    """Means, smallest distances and numbers of points of cells."""
    means, least_m, counts = np.zeros((cells, 3)), np.full(cells, np.inf), np.zeros(cells, np.int64)
    for i in range(len(points)):
        k = cell_of_point[i]
        counts[k] += 1
        least_m[k] = min(least_m[k], distance_m[i])
        for axis in range(3):
            means[k, axis] += _exact(points[i, axis])
    for k in range(cells):
        for axis in range(3):
            means[k, axis] /= counts[k]
    return means, least_m, counts


@inlined
def _bucket(way_m: float, per_m: float) -> int:
    """Bucket of a coordinate along a grid, clamped at the first and the last one."""
    place = way_m * per_m
    if way_m > 0.0:
        return int(place) if place < MAX_BUCKET else int(MAX_BUCKET)
    return 0


@compiled("Tuple((int64, int64[::1]))(float64[:, ::1], float64[::1], float64[::1])")
def _link(points: F64, distance_m: F64, series: F64) -> tuple[int, I64]:
    """Connected parts of the graph of points at most the smaller of their distances apart.

    Each part grows from its first point, and what is reached is taken out of its bucket: it is not met again. The
    points of each level of distances lie in a square grid of their own, with buckets of that size, so that far points
    with their wide search do not look at many near ones. A grid has more squares than there are buckets: after the
    last one comes the first one again, and what lies in it by chance is too far away.

    Args:
        points: (N, 3) metres.
        distance_m: (N,) positive.
        series: Levels of these: a rising series from the least one.

    Returns:
        The number of parts, and (N,) the part of each point, numbered in order of their first point.
    """
    count, levels = len(points), len(series)
    level, sizes, longest_m = np.empty(count, np.int64), np.zeros(levels, np.int64), np.zeros(levels)
    low, high = np.full((levels, 2), np.inf), np.full((levels, 2), -np.inf)
    for i in range(count):
        own = _level(distance_m[i], series)
        level[i] = own
        sizes[own] += 1
        longest_m[own] = max(longest_m[own], distance_m[i])
        for axis in range(2):
            low[own, axis] = min(low[own, axis], points[i, axis])
            high[own, axis] = max(high[own, axis], points[i, axis])

    first, mask, per_m = np.empty(levels, np.int64), np.empty(levels, np.int64), np.empty(levels)
    columns, lines, buckets = np.empty(levels, np.int64), np.empty(levels, np.int64), 0
    for own in range(levels):
        size = 1
        while size < 2 * sizes[own]:
            size *= 2
        first[own], mask[own], per_m[own] = buckets, size - 1, BUCKETS_ACROSS / longest_m[own]
        columns[own] = _bucket(high[own, 0] - low[own, 0], per_m[own]) + 1
        lines[own] = _bucket(high[own, 1] - low[own, 1], per_m[own]) + 1
        buckets += size
    bucket, stops = np.empty(count, np.int64), np.zeros(buckets + 1, np.int64)
    for i in range(count):
        own = level[i]
        column = _bucket(points[i, 0] - low[own, 0], per_m[own])
        line = _bucket(points[i, 1] - low[own, 1], per_m[own])
        bucket[i] = first[own] + ((column * lines[own] + line) & mask[own])
        stops[bucket[i] + 1] += 1
    for k in range(buckets):
        stops[k + 1] += stops[k]
    starts = stops.copy()
    near, near_row = np.empty((count, 4)), np.empty(count, np.int64)  # bucket after bucket
    for i in range(count):
        place = stops[bucket[i]]
        stops[bucket[i]] += 1
        near_row[place] = i
        near[place, 0], near[place, 1], near[place, 2] = points[i, 0], points[i, 1], points[i, 2]
        near[place, 3] = distance_m[i] * distance_m[i]

    part, parts, reached = np.full(count, -1, np.int64), 0, np.empty(count, np.int64)
    for seed in range(count):
        if part[seed] >= 0:
            continue
        part[seed], reached[0], done, found = parts, seed, 0, 1
        while done < found:
            row = reached[done]
            done += 1
            x, y, z, own_m2 = points[row, 0], points[row, 1], points[row, 2], distance_m[row] * distance_m[row]
            for other in range(levels):
                if sizes[other] == 0:
                    continue
                reach_m = min(distance_m[row], longest_m[other]) * ROOM
                east, north, scale = x - low[other, 0], y - low[other, 1], per_m[other]
                stop_column = min(_bucket(east + reach_m, scale) + 1, columns[other])
                stop_line = min(_bucket(north + reach_m, scale) + 1, lines[other])
                for column in range(_bucket(east - reach_m, scale), stop_column):
                    for line in range(_bucket(north - reach_m, scale), stop_line):
                        k = first[other] + ((column * lines[other] + line) & mask[other])
                        place = starts[k]
                        while place < stops[k]:
                            dx, dy, dz = x - near[place, 0], y - near[place, 1], z - near[place, 2]
                            if not dx * dx + dy * dy + dz * dz <= min(own_m2, near[place, 3]):
                                place += 1
                                continue
                            if part[near_row[place]] < 0:
                                part[near_row[place]], reached[found] = parts, near_row[place]
                                found += 1
                            stops[k] -= 1
                            near_row[place] = near_row[stops[k]]
                            for axis in range(4):
                                near[place, axis] = near[stops[k], axis]
        parts += 1
    return parts, part
