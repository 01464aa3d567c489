"""The loops of `parting.py` over the points of objects."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64
from pipeline.core.compiled import compiled

__all__ = ["boxes_that_hold", "nearest_of_team"]

_ROWS, _POINTS = "Array(int64, 1, 'C', True)", "Array(float32, 2, 'C', True)"
_LIST, _TABLE = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2))


@compiled(f"int64[::1]({_POINTS}, {_ROWS}, {_ROWS}, {_TABLE}, {_TABLE}, {_LIST}, {_LIST}, float64)")
def boxes_that_hold(
    xyz: F32, rows: I64, ends: I64, centers: F64, half: F64, cosines: F64, sines: F64, share: float
) -> I64:
    """(G,) the box that holds most of the points of each object, of those alike the first; -1 where none holds enough.

    Args:
        xyz: (N, 3) metres.
        rows: (P,) points of the objects, object after object.
        ends: (G,) behind the last point of each object.
        centers: (B, 3) metres.
        half: (B, 3) of length, width and height.
        cosines: (B,) of the yaws.
        sines: (B,) of these.
        share: A box has to hold more of the points.
    """
    found, start = np.full(len(ends), -1), 0
    for g in range(len(ends)):
        count, most = ends[g] - start, 0
        for box in range(len(centers)):
            held = 0
            for i in range(start, ends[g]):
                x, y = xyz[rows[i], 0] - centers[box, 0], xyz[rows[i], 1] - centers[box, 1]
                forward, left = x * cosines[box] + y * sines[box], y * cosines[box] - x * sines[box]
                up = xyz[rows[i], 2] - centers[box, 2]
                held += abs(forward) <= half[box, 0] and abs(left) <= half[box, 1] and abs(up) <= half[box, 2]
                at_most = held + ends[g] - i - 1
                if at_most <= most or at_most / count <= share:
                    break
            if held > most and held / count > share:
                found[g], most = box, held
        start = ends[g]
    return found


@compiled(f"int64[::1]({_ROWS}, {_ROWS}, {_LIST}, {_ROWS})")
def nearest_of_team(rows: I64, group: I64, aside: F64, team: I64) -> I64:
    """See `parting.share_points`.

    Args:
        rows: (P,) the points.
        group: (P,) the frustum of each, rising.
        aside: (P,) how far it is from the middle of its frustum.
        team: (F,) of each frustum.
    """
    last, frustums, count = -1, len(team), len(rows)
    starts = np.zeros(frustums + 1, np.int64)
    for i in range(count):
        last = max(last, rows[i])
        starts[group[i] + 1] += 1
    for f in range(frustums):
        starts[f + 1] += starts[f]
    nearest, kept = np.full(last + 1, -1), np.zeros(count, np.bool_)
    for first in range(frustums):
        is_first = True
        for f in range(first):
            is_first = is_first and team[f] != team[first]
        if not is_first:
            continue
        for f in range(first, frustums):
            if team[f] == team[first]:
                for i in range(starts[f], starts[f + 1]):
                    other = nearest[rows[i]]
                    if other < 0 or aside[i] < aside[other]:
                        nearest[rows[i]] = i
        for f in range(first, frustums):
            if team[f] == team[first]:
                for i in range(starts[f], starts[f + 1]):
                    if nearest[rows[i]] >= 0:
                        kept[nearest[rows[i]]] = True
                        nearest[rows[i]] = -1
    return np.flatnonzero(kept)
