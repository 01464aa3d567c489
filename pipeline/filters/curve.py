"""Points in their order along a curve that fills space, so that those near in the order are near in space.

Hilbert's curve, computed after Skilling (Programming the Hilbert curve, AIP Conference Proceedings 707, 2004).
Compiled: see `lidcam.pipeline.core.compiled`.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64
from lidcam.pipeline.core.compiled import compiled, inlined

AXIS_BITS = 11

CELLS = 1 << AXIS_BITS
"""Cells of the curve along each axis."""

ROW_BITS = 63 - 3 * AXIS_BITS
ROW = (1 << ROW_BITS) - 1
"""A point is one number while points are sorted: its index in these bits, its place on the curve above them."""

CHUNK = 1024
"""Points that are numbered at once, so that their cells stay in the processor's cache."""

CROWD = 256
"""More points than this in one cell are sorted anew, in smaller cells."""


@inlined
def _turned(x: np.int32, other: np.int32, bit: np.int32) -> tuple[np.int32, np.int32]:
    """Inverts the lower bits of x if the bit is set in the other number; else exchanges those of both."""
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


@compiled("int64[::1](Array(float32, 2, 'C', True), float64[::1], float64)")
def _places(xyz: F32, low: F64, scale: float) -> I64:
    """(N,) places on the curve and rows, see `ROW`, of points (3, N)."""
    count = xyz.shape[1]
    places = np.empty(count, np.int64)
    cells = np.zeros((3, CHUNK), np.int32)
    for start in range(0, count, CHUNK):
        size = min(CHUNK, count - start)
        for axis in range(3):
            for j in range(size):  # masked: nothing is written beyond an array whatever the numbers are
                cells[axis, j] = np.int32((xyz[axis, start + j] - low[axis]) * scale) & (CELLS - 1)
        _numbered(cells)
        for j in range(CHUNK):
            cells[0, j], cells[1, j], cells[2, j] = _apart(cells[0, j]), _apart(cells[1, j]), _apart(cells[2, j])
        for j in range(size):
            place = (np.int64(cells[0, j]) << 2) | (np.int64(cells[1, j]) << 1) | np.int64(cells[2, j])
            places[start + j] = (place << ROW_BITS) | (start + j)
    return places


def curve_order(xyz: F32) -> I64:
    """(N,) indices of the points (3, N), finite, N >= 1, along the curve; points at one place by their indices."""
    low = xyz.min(axis=1).astype(np.float64)
    edge = float((xyz.max(axis=1) - low).max())
    if edge == 0:
        return np.arange(xyz.shape[1])
    places = _places(xyz, low, (CELLS - 1) / edge)
    places.sort()
    order, cells = places & ROW, places >> ROW_BITS
    bounds = np.flatnonzero(np.diff(cells, prepend=-1, append=-1))
    for i in np.flatnonzero(np.diff(bounds) > CROWD):
        crowd = order[bounds[i] : bounds[i + 1]]
        crowd[:] = crowd[curve_order(np.take(xyz, crowd, axis=1))]
    return order
