"""The surface that grows towards the lowest points of the ground: see `pipeline.filters.relief`.

Compiled: see `pipeline.core.compiled`. Only the nodes that are pulled, and those that smoothing carries this on to, are
looked at: elsewhere the surface stays zero. Grids are (rows along y, columns along x).
"""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["grown", "smooth"]

ROWS_AT_ONCE = 8
"""Rows of a grid that are smoothed together: enough for long loops, few enough to stay near the processor."""


@inlined
def _symmetric(sums: F64, values: F64, count: int, stride: int, taps: F64) -> None:
    """Writes sums of values, weighted by taps: sum i is about value i + stride x (taps to one side)."""
    reach = len(taps) - 1
    middle = values[reach * stride :]
    for i in range(count):
        sums[i] = middle[i] * taps[0]
    for step in range(reach, 0, -1):
        before, after, tap = values[(reach - step) * stride :], values[(reach + step) * stride :], taps[step]
        for i in range(count):
            sums[i] += (before[i] + after[i]) * tap


@compiled("void(float64[:, ::1], float64[::1], int64, float64[::1])")
def smooth(values: F64, taps: F64, margin: int, smoothed: F64) -> None:
    """Smooth a grid (H, W), 0 beyond its edges, along both axes.

    Args:
        values: (H, W).
        taps: (R + 1,) weight of a node itself, of those beside it, and so on.
        margin: Nodes around the grid for which the result is wanted, too; at least R, which is as far as it reaches.
        smoothed: Where the result is written to, row by row: (H + 2 margin, W + 2 margin).
    """
    height, width = values.shape
    reach = len(taps) - 1
    padded = np.zeros((height + 4 * reach) * width, np.float64)
    for row in range(height):
        for column in range(width):
            padded[(row + 2 * reach) * width + column] = values[row, column]
    line = width + 2 * margin  # of the result; rows lie one after another, with zeros between them
    sums, lines = np.empty(ROWS_AT_ONCE * width, np.float64), np.zeros(ROWS_AT_ONCE * line + 2 * reach, np.float64)
    begin, end = (margin - reach) * line, (margin + height + reach) * line
    for i in range(begin):
        smoothed[i] = smoothed[end + i] = 0.0
    for first in range(0, height + 2 * reach, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, height + 2 * reach - first)
        _symmetric(sums, padded[first * width :], rows * width, width, taps)
        for row in range(rows):
            for column in range(width):
                lines[row * line + reach + margin + column] = sums[row * width + column]
        _symmetric(smoothed[begin + first * line :], lines, rows * line, 1, taps)


@compiled("float64[:, ::1](float64[:, ::1], float64[::1], int64, float64[::1], int64[::1], float64[::1], float64[::1])")
def grown(xy: F64, height_m: F64, side: int, taps: F64, counts: I64, near_m: F64, limits: F64) -> F64:
    """A surface that grows from zero towards cells; where there are none, it goes on as it is nearby.

    Args:
        xy: (M, 2) middles of the cells, in nodes of the surface, from 0 to `side` - 1; each pulls at the nearest node.
        height_m: (M,) their heights.
        side: The surface has so many nodes along each edge, at least 2.
        taps: Of the smoothing in each of R rounds, of that which fills gaps, and of that of the weight of what is
            known, one after another; see `smooth`.
        counts: (R + 2,) number of taps of each.
        near_m: (R,) cells farther from the surface do not pull.
        limits: (5,) cells higher above the surface than the first pull by the second; the most that a node is pulled
            by; the weight of the last surface; and that of nothing, where gaps are filled.

    Returns:
        (side, side) heights.
    """
    offsets_m = np.zeros((side, side), np.float64)
    if len(xy) == 0:
        return offsets_m
    rounds, margin = len(near_m), counts.max() - 1
    left, low, right, high = side, side, 0, 0
    for i in range(len(xy)):
        column, row = int(np.rint(xy[i, 0])), int(np.rint(xy[i, 1]))
        left, low, right, high = min(left, column), min(low, row), max(right, column), max(high, row)
    rows, columns = high - low + 1, right - left + 1  # those that are pulled
    line = columns + 2 * margin

    nodes, corners, shares = np.empty(len(xy), np.int32), np.empty(len(xy), np.int32), np.empty_like(xy)
    for i in range(len(xy)):
        column, row = min(int(xy[i, 0]), side - 2), min(int(xy[i, 1]), side - 2)
        corners[i] = (row - low + margin) * line + column - left + margin
        shares[i, 0], shares[i, 1] = xy[i, 0] - column, xy[i, 1] - row
        nodes[i] = (int(np.rint(xy[i, 1])) - low) * columns + int(np.rint(xy[i, 0])) - left

    weight, mean = np.empty((rows, columns), np.float64), np.empty((rows, columns), np.float64)
    weights, means = weight.reshape(weight.size), mean.reshape(mean.size)
    surface = np.zeros((rows + 2 * margin) * line, np.float64)
    sums, totals = np.empty(len(surface), np.float64), np.empty(len(surface), np.float64)
    first = 0
    for k in range(rounds):
        for node in range(len(weights)):
            weights[node] = means[node] = 0.0
        for i in range(len(xy)):
            at, x, y = np.uint32(corners[i]), shares[i, 0], shares[i, 1]
            near = surface[at] * (1 - x) + surface[at + 1] * x
            far = surface[at + line] * (1 - x) + surface[at + line + 1] * x
            above = height_m[i] - (near * (1 - y) + far * y)
            if abs(above) <= near_m[k]:
                pull = limits[1] if above > limits[0] else 1.0
                weights[nodes[i]] += pull
                means[nodes[i]] += pull * above
        for node in range(len(weights)):
            means[node] /= max(weights[node], 1e-9)
            weights[node] = min(weights[node], limits[2])
            means[node] *= weights[node]
        own = taps[first : first + counts[k]]
        smooth(mean, own, margin, sums)
        smooth(weight, own, margin, totals)
        for i in range(len(surface)):
            surface[i] += sums[i] / (totals[i] + limits[3])
        first += counts[k]

    for row in range(rows):
        for column in range(columns):
            weight[row, column] /= limits[2]
            mean[row, column] = weight[row, column] * surface[(row + margin) * line + margin + column]
    trusted = np.empty(len(surface), np.float64)
    smooth(mean, taps[first : first + counts[rounds]], margin, sums)
    smooth(weight, taps[first : first + counts[rounds]], margin, totals)
    smooth(weight, taps[first + counts[rounds] :], margin, trusted)
    for row in range(max(low - margin, 0), min(high + margin + 1, side)):
        for column in range(max(left - margin, 0), min(right + margin + 1, side)):
            i = (row - low + margin) * line + column - left + margin
            trust, filled = trusted[i] / (trusted[i] + limits[4]), sums[i] / (totals[i] + limits[4])
            offsets_m[row, column] = trust * surface[i] + (1 - trust) * filled
    return offsets_m
