"""The sums of `outline.py`, compiled."""

import numpy as np

from pipeline.core.arrays import F64
from pipeline.core.compiled import compiled

__all__ = ["rounded_offsets"]

_LIST, _TABLE = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@compiled(f"float64[:, :, ::1]({_TABLE}, {_TABLE}, {_TABLE}, {_TABLE}, float64, float64, float64, {_LIST})")
def rounded_offsets(
    sizes: F64, signs: F64, inward: F64, of_riders: F64, rounding: float, underside: float, cabin: float, shape: F64
) -> F64:
    """(P, S, 3) offsets of `rounded_outline`.

    Args:
        sizes: (P, 3) length, width, height.
        signs: (S, 3) of the points.
        inward: (S, 2) way of each point, for a corner that is cut off by 1.
        of_riders: (S, 3) of the points of people who ride, in halves of the box.
        rounding: See `rounded_outline`.
        underside: See there.
        cabin: See there.
        shape: (5,) `UPRIGHT`, `AS_HIGH_AS_WIDE`, `TALL_ROUNDING`, `CUT_PER_RADIUS`, `RIDES`.
    """
    upright_from, high_from, tall, cut_per_radius, rides_from = shape
    offsets = np.empty((len(sizes), len(signs), 3))
    for p in range(len(sizes)):
        length, width, height = sizes[p]
        smaller = min(length, width)
        is_upright = height > upright_from * smaller
        low = min(max((high_from - height / width) / (high_from - 1), 0.0), 1.0)
        share = rounding * (tall + (1 - tall) * low)
        if is_upright:
            share = 0.5 if rounding > 0 else 0.0
        cut = cut_per_radius * (share * smaller)
        rides = rounding > 0 and is_upright and length > rides_from * width
        for s in range(len(signs)):
            if rides:
                for i in range(3):
                    offsets[p, s, i] = of_riders[s, i] * sizes[p, i] / 2
                continue
            for i in range(2):
                offsets[p, s, i] = inward[s, i] * cut
                if signs[s, 2] == 1:
                    offsets[p, s, i] -= signs[s, i] * (cabin * low * sizes[p, i] / 2)
            offsets[p, s, 2] = (underside if signs[s, 2] < 0 else 0.0) * height
    return offsets
