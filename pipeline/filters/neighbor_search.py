"""Exact distances to nearest neighbours, for all points of a cloud at once.

The points of a run look for neighbours together, each in a lane of a vector of sixteen numbers: a point of another run
is compared with all of them by a few instructions. Boxes that are farther away than the neighbours found so far are
left out. The ten nearest of each stay in registers. Compiled: see `pipeline.core.compiled`, and `lanes` there. Without
vectors, as loops over sixteen numbers, it takes several times as long.
"""

import numpy as np

from pipeline.core.arrays import F32, I32, I64
from pipeline.core.compiled import compiled, inlined
from pipeline.core.compiled.lanes import (
    RANKS,
    Lanes,
    below,
    highest,
    larger,
    last_rank,
    load,
    lowest_bit,
    ranks_of,
    replaced,
    roots,
    share,
    smaller,
    spread,
    store,
    store_ranks,
    with_one_more,
)
from pipeline.filters.box_tree import RUN

__all__ = ["mean_distances"]

BOX = 6 * RUN
"""Numbers of a node of boxes: the lowest x of its children, their lowest y, z, and the highest."""

LARGEST = np.float32(np.finfo(np.float32).max)
"""The square of all distances whose square is not below it."""


@inlined
def _beyond(low: Lanes, other_low: Lanes, other_high: Lanes, high: Lanes) -> Lanes:
    """The square of how far [low, high] is from [other_low, other_high] along an axis."""
    gap = larger(larger(low - other_high, other_low - high), spread(np.float32(0)))
    squared: Lanes = gap * gap
    return squared


@inlined
def _insert(others: F32, count: int, distance: Lanes) -> None:
    """Puts distances in order among so many ranks of sixteen numbers each; the largest of each lane goes."""
    row = (count - 1) * RUN
    after = load(others, row)
    while row > 0:
        row -= RUN
        before = load(others, row)
        store(others, row + RUN, smaller(after, larger(before, distance)))
        after = before
    store(others, 0, smaller(after, distance))


@inlined
def _squared(x: Lanes, y: Lanes, z: Lanes, xs: F32, ys: F32, zs: F32, i: int) -> Lanes:
    """Squared distances of points to another one."""
    dx, dy, dz = x - spread(xs[i]), y - spread(ys[i]), z - spread(zs[i])
    squared: Lanes = dx * dx + dy * dy + dz * dz
    return squared


@compiled("float32[::1](float32[:, ::1], float32[:, :, ::1], int64[::1], int32[::1], int64)")
def mean_distances(points: F32, boxes: F32, first: I64, order: I32, neighbors: int) -> F32:
    """(N,) mean distance of each point to its nearest neighbours, other than itself, as PCL rounds it.

    Squares of distances, their sums and roots in float32, the sum over the neighbours, nearest first, in float64.

    Args:
        points: As `pipeline.filters.box_tree.box_tree` returns them.
        boxes: Likewise.
        first: Likewise.
        order: (N,) row of the result for each point.
        neighbors: At least 1, below N.
    """
    count, levels, runs = len(order), len(first) - 1, points.shape[1] // RUN
    xs, ys, zs, corners = points[0], points[1], points[2], boxes.reshape(boxes.size)
    means = np.empty(count, np.float32)
    beyond = max(neighbors - RANKS, 0)  # neighbours that the registers do not hold
    nearest, others = np.empty(max(neighbors, RANKS) * RUN, np.float32), np.empty((beyond + 1) * RUN, np.float32)
    squares, gaps = np.empty(RUN * RUN, np.float32), np.empty(RUN, np.float32)
    # Boxes still to look at: each puts at most sixteen smaller ones in its place. Not in the order of their distance:
    # fewer would be looked at, but sorting takes longer than that.
    box_gap = np.empty((levels + 1) * RUN, np.float32)
    box_level, box_number = np.empty((levels + 1) * RUN, np.int64), np.empty((levels + 1) * RUN, np.int64)

    for run in range(runs):
        begin = run * RUN
        x, y, z = load(xs, begin), load(ys, begin), load(zs, begin)
        ranks = ranks_of(spread(LARGEST))
        for row in range(0, beyond * RUN, RUN):
            store(others, row, spread(LARGEST))
        for j in range(min(RUN, count - begin)):
            distance = replaced(_squared(x, y, z, xs, ys, zs, begin + j), j, LARGEST)  # not to itself
            if beyond > 0:
                _insert(others, beyond, larger(last_rank(ranks), distance))
            ranks = with_one_more(ranks, distance)
        at = run // RUN * BOX + run % RUN
        x_low, y_low, z_low = spread(corners[at]), spread(corners[at + RUN]), spread(corners[at + 2 * RUN])
        at += 3 * RUN
        x_high, y_high, z_high = spread(corners[at]), spread(corners[at + RUN]), spread(corners[at + 2 * RUN])
        farthest = last_rank(ranks) if beyond == 0 else load(others, (beyond - 1) * RUN)
        limit = highest(farthest)

        # Those before and behind it on the curve, which are near as a rule; then from the run upwards: the other boxes
        # of its node, then those of the node above, and so on.
        waiting, above, climbed, beside = 0, run, 0, 2
        while waiting > 0 or climbed < levels:
            if beside > 0:
                beside -= 1
                level, node, left_out = -1, run - 1 + 2 * beside, 0
                if node < 0 or node >= runs:
                    continue
            elif waiting > 0:
                waiting -= 1
                if box_gap[waiting] >= limit:
                    continue
                level, node, left_out = box_level[waiting] - 1, box_number[waiting], 0
                if level < 0 and abs(node - run) == 1:
                    continue
                at = (first[level + 1] + node // RUN) * BOX + node % RUN
                gap = _beyond(spread(corners[at]), x, x, spread(corners[at + 3 * RUN]))
                gap = gap + _beyond(spread(corners[at + RUN]), y, y, spread(corners[at + 4 * RUN]))
                gap = gap + _beyond(spread(corners[at + 2 * RUN]), z, z, spread(corners[at + 5 * RUN]))
                if below(gap, farthest) == 0:
                    continue
            else:
                level, node, left_out = climbed, above // RUN, 1 << (above % RUN)
                above, climbed = node, climbed + 1

            if level < 0:
                begin_other, nearer = node * RUN, 0
                for j in range(RUN):
                    distance = _squared(x, y, z, xs, ys, zs, begin_other + j)
                    store(squares, j * RUN, distance)
                    nearer |= (1 if below(distance, farthest) != 0 else 0) << j
                if begin_other + RUN > count:
                    nearer &= (1 << (count - begin_other)) - 1  # the others are copies of the last point
                if nearer != 0:
                    while nearer != 0:
                        distance = load(squares, lowest_bit(nearer) * RUN)
                        if beyond > 0:
                            _insert(others, beyond, larger(last_rank(ranks), distance))
                        ranks = with_one_more(ranks, distance)
                        nearer &= nearer - 1
                    farthest = last_rank(ranks) if beyond == 0 else load(others, (beyond - 1) * RUN)
                    limit = highest(farthest)
                continue

            at = (first[level] + node) * BOX
            gap = _beyond(load(corners, at), x_low, x_high, load(corners, at + 3 * RUN))
            gap = gap + _beyond(load(corners, at + RUN), y_low, y_high, load(corners, at + 4 * RUN))
            gap = gap + _beyond(load(corners, at + 2 * RUN), z_low, z_high, load(corners, at + 5 * RUN))
            store(gaps, 0, gap)
            near = below(gap, spread(limit)) & ~left_out
            while near != 0:
                child = lowest_bit(near)
                near &= near - 1
                box_gap[waiting], box_level[waiting], box_number[waiting] = gaps[child], level, node * RUN + child
                waiting += 1

        store_ranks(nearest, ranks)
        for i in range(beyond * RUN):
            nearest[RANKS * RUN + i] = others[i]
        total = roots(load(nearest, 0))
        for row in range(RUN, neighbors * RUN, RUN):
            total = total + roots(load(nearest, row))
        store(gaps, 0, share(total, neighbors))
        for j in range(min(RUN, count - begin)):
            means[order[begin + j]] = gaps[j]
    return means
