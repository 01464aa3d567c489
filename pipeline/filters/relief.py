"""How the ground differs from its plane: slopes, crests, kerbs.

A surface grows from the plane outwards: the lowest points of small cells that lie near the surface pull it towards
them, smoothly, and so bring further points near. Walls and vehicles are not near, or not lowest. This is a filter of
the kind of Kraus and Pfeifer (Determination of terrain models in wooded areas with airborne laser scanner data, ISPRS
Journal 53(4), 1998), which weighs points by their height above the last surface, on a grid in place of linear
prediction. Grids are (rows along y, columns along x).
"""

from functools import cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64
from lidcam.pipeline.core.clouds import Plane, Relief
from lidcam.pipeline.core.compiled import compiled, inlined
from lidcam.pipeline.core.settings.combine import GroundConfig

CELL_PER_DISTANCE = 10.0
"""Edge of a cell of the surface, as a multiple of `distance_m`."""

FINE_SHARE = 0.5
"""Edge of the cells whose lowest points are taken, as a share of that."""

LAYER_SHARE = 0.35
"""The height of a fine cell is the mean of its points up to this share of `distance_m` above the lowest."""

REACH_CELLS = 48
"""The surface reaches this many cells from the middle of the lidars to each side; beyond, it goes on level."""

MAX_SLOPE = 0.08
"""Points farther from the plane than this multiple of their distance from the lidars are no ground."""

ROUNDS = ((4.0, 3.0),) * 5 + ((2.0, 2.0),) * 2 + ((1.0, 1.0),) * 3
"""Rounds of growth: standard deviation of the smoothing in cells, and what is near, as a multiple of `distance_m`. The
wide ones bridge the gaps between the rings of a lidar and follow a slope; the narrow ones leave out what stands on it.
"""

ABOVE_PER_DISTANCE = 0.75
"""Height above the last surface, as a multiple of `distance_m`, from which on points may stand on the ground."""

ABOVE_WEIGHT = 0.1
"""Weight of such points."""

MAX_POINTS = 4.0
"""Fine cells of a cell that count: no cell pulls more than one full of ground."""

PRIOR_WEIGHT = 0.05
"""Weight of the last surface against the points of a cell."""

FILL_CELLS = 5.0
"""Standard deviation, in cells, of the smoothing that fills unknown parts of the surface from known ones."""

FILL_WEIGHT = 0.02
"""Weight of the plane in those parts."""

TRUST_CELLS = 1.0
"""Standard deviation, in cells, of the smoothing of known parts' borders."""

REACH_OF_GAUSSIAN = 2.5
"""Largest reach of the smoothing, in standard deviations."""

POINTS = "Array(float32, 2, 'C', True)"
"""Type of points in columns, perhaps read-only."""


def find_relief(xyz_site: F32, lidar_origins_site: F64, plane: Plane, config: GroundConfig) -> Relief:
    """The height of the ground above its plane.

    Args:
        xyz_site: (N, 3) points in the site frame, metres, finite; best as a row per coordinate in memory.
        lidar_origins_site: (L, 3) origins of the lidars in the site frame, metres.
        plane: The ground plane of the same points.
        config: Limits of the ground.
    """
    cell_m = CELL_PER_DISTANCE * config.distance_m
    middle = lidar_origins_site[:, :2].mean(axis=0)
    origin = middle - REACH_CELLS * cell_m
    side = 2 * REACH_CELLS + 1
    xy, height = _lowest(xyz_site, middle, plane, origin, cell_m, config.distance_m)
    xy = (xy - origin) / cell_m
    taps = [_taps(cells) for cells in (*(spread_cells for spread_cells, _ in ROUNDS), FILL_CELLS, TRUST_CELLS)]
    offsets_m = _grown(
        xy,
        height,
        side,
        np.concatenate(taps),
        np.array([len(one) for one in taps]),
        np.array([reach * config.distance_m for _, reach in ROUNDS]),
        np.array([ABOVE_PER_DISTANCE * config.distance_m, ABOVE_WEIGHT, MAX_POINTS, PRIOR_WEIGHT, FILL_WEIGHT]),
    )
    return Relief(origin, cell_m, offsets_m)


def _lowest(xyz: F32, middle: F64, plane: Plane, origin: F64, cell_m: float, distance_m: float) -> tuple[F64, F64]:
    """The middles of the fine cells that hold ground, perhaps (M, 2), and their lowest heights above the plane (M,)."""
    fine_m = FINE_SHARE * cell_m
    side = round(2 * REACH_CELLS / FINE_SHARE)
    cells, heights = _lowest_of_cells(
        np.ascontiguousarray(xyz.T),
        np.append(plane.normal, plane.offset_m).astype(np.float32),
        middle.astype(np.float32),
        origin.astype(np.float32),
        np.float32(fine_m),
        side,
        np.float32(distance_m),
        np.float32(MAX_SLOPE),
        np.float32(LAYER_SHARE * distance_m),
    )
    return origin + (np.stack([cells % side, cells // side], 1) + 0.5) * fine_m, heights


@cache
def _taps(cells: float) -> F64:
    """Half a Gaussian of this standard deviation, from its middle on; with the other half, its sum is 1."""
    reach = int(REACH_OF_GAUSSIAN * cells + 0.5)
    taps = np.exp(-0.5 / cells**2 * np.arange(-reach, reach + 1) ** 2)
    half: F64 = (taps / taps.sum())[reach:]
    return half


@compiled(
    f"Tuple((int64[::1], float64[::1]))({POINTS}, float32[::1], float32[::1], float32[::1], "
    "float32, int64, float32, float32, float32)"
)
def _lowest_of_cells(
    points: F32,
    plane: F32,
    middle: F32,
    origin: F32,
    cell_m: np.float32,
    side: int,
    reach_m: np.float32,
    slope: np.float32,
    layer_m: np.float32,
) -> tuple[I64, F64]:
    """The cells of a grid that hold points near a plane, and the mean height of the lowest of them above it."""
    count = points.shape[1]
    cells, heights = np.empty(count, np.int32), np.empty(count, np.float32)
    kept, first, last = 0, side * side, -1
    for i in range(count):
        x, y = points[0, i], points[1, i]
        height = (x * plane[0] + y * plane[1] + points[2, i] * plane[2] + plane[3]) / plane[2]
        if abs(height) > reach_m:
            dx, dy = x - middle[0], y - middle[1]
            if not abs(height) <= reach_m + slope * np.sqrt(dx * dx + dy * dy):
                continue
        column, row = np.floor((x - origin[0]) / cell_m), np.floor((y - origin[1]) / cell_m)
        if 0 <= column < side and 0 <= row < side:
            cell = int(row) * side + int(column)
            first, last = min(first, cell), max(last, cell)
            cells[kept], heights[kept] = cell, height
            kept += 1

    size = max(last - first + 1, 0)  # of the part of the grid that holds points
    lowest, counts, sums = np.full(size, np.float32(np.inf)), np.zeros(size, np.int32), np.zeros(size, np.float64)
    for j in range(kept):
        at = np.uint32(cells[j] - first)
        lowest[at] = min(lowest[at], heights[j])
    held = 0
    for j in range(kept):
        at = np.uint32(cells[j] - first)
        if heights[j] <= lowest[at] + layer_m:
            held += 1 if counts[at] == 0 else 0
            counts[at] += np.int32(1)
            sums[at] += heights[j]
    found, means = np.empty(held, np.int64), np.empty(held, np.float64)
    held = 0
    for j in range(size):
        if counts[j] > 0:
            found[held], means[held] = first + j, sums[j] / counts[j]
            held += 1
    return found, means


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
def _smooth(values: F64, taps: F64, margin: int, smoothed: F64) -> None:
    """Smooth a grid (H, W), 0 beyond its edges, along both axes."""
    height, width = values.shape
    reach = len(taps) - 1
    rows, line = height + 2 * reach, width + 2 * margin  # of the result, whose rows lie one after another
    padded, sums = np.zeros((height + 4 * reach) * width, np.float64), np.empty(rows * width, np.float64)
    for row in range(height):
        for column in range(width):
            padded[(row + 2 * reach) * width + column] = values[row, column]
    _symmetric(sums, padded, rows * width, width, taps)
    lines = np.zeros(rows * line + 2 * reach, np.float64)
    for row in range(rows):
        for column in range(width):
            lines[row * line + reach + margin + column] = sums[row * width + column]
    begin = (margin - reach) * line
    for i in range(begin):
        smoothed[i] = smoothed[begin + rows * line + i] = 0.0
    _symmetric(smoothed[begin:], lines, rows * line, 1, taps)


@compiled("float64[:, ::1](float64[:, ::1], float64[::1], int64, float64[::1], int64[::1], float64[::1], float64[::1])")
def _grown(xy: F64, height_m: F64, side: int, taps: F64, counts: I64, near_m: F64, limits: F64) -> F64:
    """A surface that grows from zero towards cells; where there are none, it goes on as it is nearby.

    Only the nodes that are pulled, and those that smoothing carries this on to, are looked at: elsewhere it stays zero.
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
        _smooth(mean, own, margin, sums)
        _smooth(weight, own, margin, totals)
        for i in range(len(surface)):
            surface[i] += sums[i] / (totals[i] + limits[3])
        first += counts[k]

    for row in range(rows):
        for column in range(columns):
            weight[row, column] /= limits[2]
            mean[row, column] = weight[row, column] * surface[(row + margin) * line + margin + column]
    trusted = np.empty(len(surface), np.float64)
    _smooth(mean, taps[first : first + counts[rounds]], margin, sums)
    _smooth(weight, taps[first : first + counts[rounds]], margin, totals)
    _smooth(weight, taps[first + counts[rounds] :], margin, trusted)
    for row in range(max(low - margin, 0), min(high + margin + 1, side)):
        for column in range(max(left - margin, 0), min(right + margin + 1, side)):
            i = (row - low + margin) * line + column - left + margin
            trust, filled = trusted[i] / (trusted[i] + limits[4]), sums[i] / (totals[i] + limits[4])
            offsets_m[row, column] = trust * surface[i] + (1 - trust) * filled
    return offsets_m
