"""Exact distances to nearest neighbours, for all points of a cloud at once.

The points are sorted along a curve and cut into runs of neighbours, with a box around each run and around each block
of runs. The points of a run look for neighbours together: boxes and points that are farther away than the known
neighbours are left out. Compiled: see `lidcam.pipeline.core.compiled`.

The innermost loops go through the points of a run, or through boxes, so that the compiler makes vectors of them.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.filters.curve import curve_order

RUN = 32
"""Points of a run, and runs of a block. LLVM takes loops of sixteen steps apart before it makes vectors of them."""

RANKS = 10
"""Neighbours inserted in one pass: `outliers.NEIGHBORS`."""

_ROW, _GRID = "float32[::1]", "float32[:, ::1]"
"""Types of arrays."""

LARGEST = np.float32(np.finfo(np.float32).max)
"""The square of all distances whose square is not below it."""


@inlined
def _smaller(a: np.float32, b: np.float32) -> np.float32:
    return a if a < b else b


@inlined
def _larger(a: np.float32, b: np.float32) -> np.float32:
    return a if a > b else b


@inlined
def _beyond(low: np.float32, high: np.float32, other_low: np.float32, other_high: np.float32) -> np.float32:
    """The square of how far [low, high] is from [other_low, other_high] along an axis."""
    gap = _larger(_larger(low - other_high, other_low - high), np.float32(0))
    return gap * gap


@inlined
def _gaps(lows: F32, highs: F32, box: F32, gaps: F32) -> None:
    """Writes the squared distances of boxes from another one."""
    for i in range(len(gaps)):
        gap = _beyond(lows[0, i], highs[0, i], box[0], box[3])
        gap += _beyond(lows[1, i], highs[1, i], box[1], box[4])
        gaps[i] = gap + _beyond(lows[2, i], highs[2, i], box[2], box[5])


@inlined
def _any_nearer(points: F32, box: F32, farthest: F32) -> bool:
    """Whether a box is nearer to one of the points (3, RUN) than `farthest` (RUN,) of it, squared."""
    nearer = False
    for i in range(RUN):
        gap = _beyond(points[0, i], points[0, i], box[0], box[3])
        gap += _beyond(points[1, i], points[1, i], box[1], box[4])
        gap += _beyond(points[2, i], points[2, i], box[2], box[5])
        nearer |= gap < farthest[i]
    return nearer


@inlined
def _squares(points: F32, x: np.float32, y: np.float32, z: np.float32, farthest: F32, squares: F32) -> bool:
    """Writes the squared distances (RUN,) of points (3, RUN) from another one: whether one is below `farthest`."""
    nearer = False
    for i in range(RUN):
        dx, dy, dz = points[0, i] - x, points[1, i] - y, points[2, i] - z
        squares[i] = dx * dx + dy * dy + dz * dz
        nearer |= squares[i] < farthest[i]
    return nearer


@inlined
def _insert(squares: F32, nearest: F32) -> None:
    """Puts a square for each point in order among those found so far; the largest of each point goes."""
    for begin in range(len(nearest) - (RANKS + 1) * RUN, -1, -RANKS * RUN):
        rows = nearest[begin:]
        for i in range(RUN):
            for row in range(RANKS * RUN, 0, -RUN):
                rows[row + i] = _larger(rows[row - RUN + i], _smaller(rows[row + i], squares[i]))


@compiled(f"float32({_GRID}, {_ROW}, {_GRID}, int64, boolean, float32, {_ROW}, {_ROW})")
def _compared(
    own: F32, box: F32, others: F32, count: int, is_same: bool, limit: np.float32, nearest: F32, farthest: F32
) -> np.float32:
    """Compare the points of a run with those of another one."""
    gaps, squares = np.empty(RUN, np.float32), np.empty(RUN, np.float32)
    _gaps(others, others, box, gaps)
    for j in range(count):
        if gaps[j] < limit and _squares(own, others[0, j], others[1, j], others[2, j], farthest, squares):
            if is_same:
                squares[j] = LARGEST
            _insert(squares, nearest)
    highest = np.float32(0)
    for i in range(RUN):
        highest = _larger(highest, farthest[i])
    return highest


@compiled(f"{_ROW}(float32[:, :, ::1], {_GRID}, float32[:, :, ::1], {_GRID}, int64, int64)")
def _mean_distances(points: F32, boxes: F32, children: F32, blocks: F32, count: int, neighbors: int) -> F32:
    """(N,) mean distance of each point to its nearest neighbours."""
    runs = (count + RUN - 1) // RUN
    means = np.empty(runs * RUN, np.float32)
    nearest = np.zeros(((neighbors + RANKS - 1) // RANKS * RANKS + 1) * RUN, np.float32)
    farthest = nearest[neighbors * RUN : (neighbors + 1) * RUN]
    block_gaps, gaps = np.empty(blocks.shape[1], np.float32), np.empty(RUN, np.float32)
    totals = np.empty(RUN, np.float64)
    for run in range(runs):
        own, box, limit = points[run], boxes[run], LARGEST
        nearest[RUN:] = LARGEST
        for other in (run, run - 1, run + 1):  # near on the curve is near in space as a rule
            if other >= 0 and other < runs:
                there, is_same = min(RUN, count - other * RUN), other == run
                limit = _compared(own, box, points[other], there, is_same, limit, nearest, farthest)
        _gaps(blocks[:3], blocks[3:], box, block_gaps)
        for block in range(len(block_gaps)):
            if block_gaps[block] >= limit:
                continue
            _gaps(children[block, :3], children[block, 3:], box, gaps)
            for i in range(RUN):
                other = block * RUN + i
                if gaps[i] < limit and abs(other - run) > 1 and _any_nearer(own, boxes[other], farthest):
                    there = min(RUN, count - other * RUN)
                    limit = _compared(own, box, points[other], there, False, limit, nearest, farthest)
        totals[:] = 0.0
        for row in range(RUN, neighbors * RUN + 1, RUN):
            for i in range(RUN):
                totals[i] += np.sqrt(nearest[row + i])
        for i in range(RUN):
            means[run * RUN + i] = totals[i] / neighbors
    return means[:count]


def mean_neighbor_distance_m(xyz: F32, neighbors: int) -> F32:
    """(N,) mean distance of finite points (N, 3) to 1 to N - 1 nearest neighbours, other than itself, as PCL rounds it.

    Squares of distances, their sums and roots in float32, the sum over the neighbours, nearest first, in float64.
    """
    rows = np.ascontiguousarray(xyz.T)
    order = curve_order(rows)
    points = rows.take(np.pad(order, (0, -len(xyz) % RUN**2), mode="edge"), axis=1)
    points = np.ascontiguousarray(points.reshape(3, -1, RUN).swapaxes(0, 1))
    boxes = np.concatenate([points.min(2), points.max(2)], axis=1)
    children = np.ascontiguousarray(boxes.reshape(-1, RUN, 6).swapaxes(1, 2))
    blocks = np.ascontiguousarray(np.concatenate([children[:, :3].min(2), children[:, 3:].max(2)], axis=1).T)
    means = np.empty(len(xyz), np.float32)
    means[order] = _mean_distances(points, boxes, children, blocks, len(xyz), neighbors)
    return means
