"""The sums of `naming.py`, compiled."""

import numpy as np

from pipeline.core.arrays import F64, I32, I64
from pipeline.core.compiled import compiled, inlined

__all__ = ["size_log_odds"]

_ROWS, _IDS = "Array(int64, 1, 'C', True)", "Array(int32, 1, 'C', True)"
_LIST, _TABLE = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@inlined
def _fit(extent: F64, is_measured: I64, first: int, typical: F64, spread: F64, weights: F64, limits: F64) -> float:
    """Log likelihood of the extents of a box, of which the first is at `first`, by a kind's typical ones."""
    total = 0.0
    for i in range(3):
        own = i if i == 2 else (i + first) % 2
        long, short = max(extent[own] - typical[i], 0.0), max(typical[i] - extent[own], 0.0)
        long = min(long / max(spread[i], 1e-9), limits[0]) * is_measured[own]
        short = min(short / (limits[1] * typical[i]), limits[2])
        total += long * long + weights[is_measured[own], i] * (short * short)
    return -total / 2


@compiled(f"float64[:, ::1]({_TABLE}, {_IDS}, {_TABLE}, {_TABLE}, {_ROWS}, {_TABLE}, {_LIST}, int64)")
def size_log_odds(
    sizes: F64,
    own_ids: I32,
    typical: F64,
    spread: F64,
    of_class: I64,
    weights: F64,
    limits: F64,
    class_count: int,
) -> F64:
    """(N, K) see `naming.class_log_odds`.

    Args:
        sizes: (N, 3) length, width, height.
        own_ids: (N,) class that the detector gives.
        typical: (M, 3) typical sizes of the kinds of all classes.
        spread: (M, 3) standard deviations above these.
        of_class: (M,) class of each kind, rising.
        weights: (2, 3) of missing extent, where it was completed and where it was measured.
        limits: (5,) `LONG_LIMIT`, `SHORT_SHARE`, `SHORT_LIMIT`, `MEASURED_SHARE`, `OWN_LOG_ODDS`.
        class_count: K.
    """
    odds, is_measured = np.full((len(sizes), class_count), -np.inf), np.empty(3, np.int64)
    for n in range(len(sizes)):
        is_measured[:] = 1
        for kind in range(len(typical)):
            for i in range(3):
                is_near = abs(sizes[n, i] - typical[kind, i]) <= limits[3] * typical[kind, i]
                if of_class[kind] == own_ids[n] and is_near:
                    is_measured[i] = 0
        has_one_side = is_measured[0] != is_measured[1]
        for kind in range(len(typical)):
            fit = _fit(sizes[n], is_measured, 0, typical[kind], spread[kind], weights, limits)
            if has_one_side and of_class[kind] != own_ids[n]:
                turned = _fit(sizes[n], is_measured, 1, typical[kind], spread[kind], weights, limits)
                fit = max(fit, turned)
            odds[n, of_class[kind]] = max(odds[n, of_class[kind]], fit)
        odds[n, own_ids[n]] += limits[4]
    return odds
