"""The points of a cloud side by side, compiled: field by field, numpy takes five times as long."""

import numpy as np

from pipeline.core.arrays import F32, I32, U16
from pipeline.core.compiled import compiled

__all__ = ["packed_points"]

_WORDS, _REALS, _WHOLE = (f"Array({kind}, 1, 'C', True)" for kind in ("uint16", "float32", "int32"))


@compiled(f"uint16[:, ::1](Array(uint16, 2, 'C', True), {_REALS}, {_WORDS}, {_WHOLE}, float64)")
def packed_points(xyz: U16, intensity: F32, ring: U16, time_offset_ns: I32, later_ns: float) -> U16:
    """(N, 11) halves of 32 bits: of x, y, z and intensity, the ring, and of the seconds since a header's stamp.

    Args:
        xyz: (N, 6) the halves of x, y, z.
        intensity: (N,).
        ring: (N,).
        time_offset_ns: (N,) since the cloud's stamp.
        later_ns: The cloud's stamp minus the header's.
    """
    count = len(xyz)
    seconds, points = np.empty(count, np.float32), np.empty((count, 11), np.uint16)
    for row in range(count):
        seconds[row] = (time_offset_ns[row] + later_ns) * 1e-9
    times, strengths = seconds.view(np.uint16), intensity.view(np.uint16)
    for row in range(count):
        for part in range(6):
            points[row, part] = xyz[row, part]
        for part in range(2):
            points[row, 6 + part], points[row, 9 + part] = strengths[2 * row + part], times[2 * row + part]
        points[row, 8] = ring[row]
    return points
