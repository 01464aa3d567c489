"""Points in runs of neighbours, and a tree of boxes around the runs, for searches that leave out most of a cloud.

The points are sorted along Hilbert's curve and cut into runs of sixteen; boxes are put around each run, around sixteen
of these boxes, and so on. The curve is computed after Skilling (Programming the Hilbert curve, AIP Conference
Proceedings 707, 2004). Compiled: see `pipeline.core.compiled`.
"""

from typing import TypeVar

import numpy as np

from pipeline.core.arrays import F32, I32, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["RUN", "box_tree", "curve_order"]

RUN = 16
"""Points of a run, and children of a box."""

AXIS_BITS = 11
"""Cells of the curve along the longest edge of the cloud, as a power of two."""

ROW_BITS = 63 - 3 * AXIS_BITS
ROW = (1 << ROW_BITS) - 1
"""A point is held as one number while points are sorted: in these bits its row, above them its place on the curve."""

CELLS = 1 << AXIS_BITS

CROWD = 256
"""More points than this in one cell of the curve are sorted anew, in smaller cells."""

CHUNK = 1024
"""Points whose cells are numbered at once: what is kept of them meanwhile is quick to reach."""

POINTS = "Array(float32, 2, 'C', True)"
"""What compiled functions take: (N, 3), perhaps read-only."""

N = TypeVar("N", int, np.float32)

LARGEST = np.float32(np.finfo(np.float32).max)


@inlined
def _smaller(a: N, b: N) -> N:
    return a if a < b else b


@inlined
def _larger(a: N, b: N) -> N:
    return a if a > b else b


@inlined
def _turned(x: np.int32, other: np.int32, bit: np.int32) -> tuple[np.int32, np.int32]:
    """Where a bit is set in another number, x with its lower bits turned over; else both with these exchanged."""
    lower = np.int32(bit - 1)
    exchanged = np.int32(0) if np.int32(other & bit) else lower
    swapped = (x ^ other) & exchanged
    return np.int32(x ^ swapped ^ lower ^ exchanged), np.int32(other ^ swapped)  # 32 bits: twice as many at once


@inlined
def _numbered(cells: I32) -> None:
    """Cells (3, N) as places on the curve, its bits dealt out to the three rows, the highest first."""
    x, y, z = cells[0], cells[1], cells[2]
    for place in range(AXIS_BITS - 1, 0, -1):
        bit = np.int32(1 << place)
        for j in range(len(x)):
            first, _ = _turned(x[j], x[j], bit)
            first, y[j] = _turned(first, y[j], bit)
            x[j], z[j] = _turned(first, z[j], bit)
    for j in range(len(x)):
        y[j] ^= x[j]
        z[j] ^= y[j]
        odd = z[j] >> 1
        odd ^= odd >> 1
        odd ^= odd >> 2
        odd ^= odd >> 4
        odd ^= odd >> 8
        x[j] ^= odd
        y[j] ^= odd
        z[j] ^= odd


@inlined
def _apart(bits: int) -> int:
    """The lowest eleven bits of a number, each at three times its place."""
    bits = (bits | (bits << 16)) & 0x070000FF
    bits = (bits | (bits << 8)) & 0x0700F00F
    bits = (bits | (bits << 4)) & 0x430C30C3
    return (bits | (bits << 2)) & 0x49249249


@inlined
def _point(xyz: F32, row: int) -> tuple[np.float32, np.float32, np.float32]:
    at = np.uint32(row)  # or each access would ask whether it counts from the end
    return xyz[at, 0], xyz[at, 1], xyz[at, 2]


@compiled(f"float64({POINTS}, int64[::1])")
def _place(xyz: F32, points: I64) -> float:
    """Writes where some of the points (N, 3) lie on a curve that fills their bounding cube.

    Args:
        xyz: All points.
        points: (M,) some of them, see `ROW`; their places are written over.

    Returns:
        The edge of the cube; if it is 0, nothing is written.
    """
    count = len(points)
    x_low = y_low = z_low = LARGEST
    x_high = y_high = z_high = -LARGEST
    for k in range(count):
        x, y, z = _point(xyz, points[k] & ROW)
        x_low, y_low, z_low = _smaller(x_low, x), _smaller(y_low, y), _smaller(z_low, z)
        x_high, y_high, z_high = _larger(x_high, x), _larger(y_high, y), _larger(z_high, z)
    x_least, y_least, z_least = np.float64(x_low), np.float64(y_low), np.float64(z_low)
    extent = max(x_high - x_least, y_high - y_least, z_high - z_least)
    if not extent > 0:
        return 0.0
    scale = (CELLS - 1) / extent
    cells = np.empty((3, CHUNK), np.int32)
    for start in range(0, count, CHUNK):
        size = min(CHUNK, count - start)
        for j in range(size):
            x, y, z = _point(xyz, points[start + j] & ROW)
            # Masked: whatever the numbers are, nothing is written beyond the ends of an array.
            cells[0, j] = np.int32((x - x_least) * scale) & (CELLS - 1)
            cells[1, j] = np.int32((y - y_least) * scale) & (CELLS - 1)
            cells[2, j] = np.int32((z - z_least) * scale) & (CELLS - 1)
        _numbered(cells)
        for j in range(CHUNK):
            cells[0, j], cells[1, j], cells[2, j] = _apart(cells[0, j]), _apart(cells[1, j]), _apart(cells[2, j])
        for j in range(size):
            place = (np.int64(cells[0, j]) << 2) | (np.int64(cells[1, j]) << 1) | np.int64(cells[2, j])
            points[start + j] = (place << ROW_BITS) | (points[start + j] & ROW)
    return float(extent)


@compiled("int64[:, ::1](int64[::1])")
def _crowds(points: I64) -> I64:
    """(M, 2) first one and the one after the last of each cell with more than `CROWD` points; of sorted points."""
    crowds = np.empty((len(points) // CROWD + 1, 2), np.int64)
    found = begin = 0
    is_crowded, half = False, CROWD // 2
    for i in range(half, len(points), half):  # of each crowd, two of these points or more
        is_crowded |= points[i - half] >> ROW_BITS == points[i] >> ROW_BITS
    if not is_crowded:
        return crowds[:0]
    for i in range(1, len(points) + 1):
        if i == len(points) or points[i] >> ROW_BITS != points[begin] >> ROW_BITS:
            if i - begin > CROWD:
                crowds[found, 0], crowds[found, 1] = begin, i
                found += 1
            begin = i
    return crowds[:found]


def curve_order(xyz: F32) -> I32:
    """(N,) rows of the points (N, 3), finite, in their order along the curve; points at one place by their rows."""
    points = np.arange(len(xyz))
    pending = [(0, len(xyz))]
    while pending:
        start, stop = pending.pop()
        some = points[start:stop]
        if _place(xyz, some) == 0:
            continue
        some.sort()  # numbers with their rows in the lowest bits: those at one place by their rows
        pending += [(start + begin, start + end) for begin, end in _crowds(some).tolist()]
    return (points & ROW).astype(np.int32)


@compiled(f"Tuple((float32[:, ::1], float32[:, :, ::1], int64[::1]))({POINTS}, int32[::1])")
def box_tree(xyz: F32, order: I32) -> tuple[F32, F32, I64]:
    """The boxes around runs of points (N, 3), N >= 1, in the given order.

    Returns:
        points: (3, M) in order; the last one again and again, up to the end of its run.
        boxes: (nodes, 6, 16), for each child of a node the lowest x, y, z of its points and the highest. Those of
            children that are not there are empty: the lowest above the highest.
        first: (levels + 1,) first node of each level, from that over the runs to the root, and their number. Node i of
            a level is child i % 16 of node i // 16 of the next one.
    """
    runs = (len(xyz) + RUN - 1) // RUN
    points = np.empty((3, runs * RUN), np.float32)
    for slot in range(runs * RUN):
        i = order[_smaller(slot, len(xyz) - 1)]
        for axis in range(3):
            points[axis, slot] = xyz[i, axis]

    levels = 1
    total = width = (runs + RUN - 1) // RUN
    while width > 1:
        width = (width + RUN - 1) // RUN
        total += width
        levels += 1
    first = np.zeros(levels + 1, np.int64)
    boxes = np.empty((total, 6, RUN), np.float32)
    for node in range(total):
        for side in range(6):
            for child in range(RUN):
                boxes[node, side, child] = LARGEST if side < 3 else -LARGEST
    for run in range(runs):
        for axis in range(3):
            low, high = LARGEST, -LARGEST
            for slot in range(run * RUN, run * RUN + RUN):
                low, high = _smaller(low, points[axis, slot]), _larger(high, points[axis, slot])
            boxes[run // RUN, axis, run % RUN] = low
            boxes[run // RUN, 3 + axis, run % RUN] = high
    children = runs
    for level in range(levels):
        nodes = (children + RUN - 1) // RUN
        first[level + 1] = first[level] + nodes
        if level + 1 < levels:
            for node in range(nodes):
                for axis in range(3):
                    low, high = LARGEST, -LARGEST
                    for child in range(RUN):
                        low = _smaller(low, boxes[first[level] + node, axis, child])
                        high = _larger(high, boxes[first[level] + node, 3 + axis, child])
                    boxes[first[level + 1] + node // RUN, axis, node % RUN] = low
                    boxes[first[level + 1] + node // RUN, 3 + axis, node % RUN] = high
        children = nodes
    return points, boxes, first
