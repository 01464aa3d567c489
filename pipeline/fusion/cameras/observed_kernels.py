"""The sums of `observed.py`, compiled."""

import math

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.compiled import compiled, inlined

__all__ = ["extents_seen", "hidden_edges"]

_ROWS = "Array(int64, 1, 'C', True)"
_LIST, _TABLE, _BLOCK = (f"Array(float64, {dimensions}, 'C', True)" for dimensions in (1, 2, 3))
_MASK = "Array(boolean, 2, 'C', True)"


@inlined
def _wrapped(angle: float) -> float:
    """As `wrap_angle`."""
    turned = angle - 2 * np.pi * math.ceil((angle - np.pi) / (2 * np.pi))
    return np.pi if turned <= -np.pi else min(turned, np.pi)


@compiled(f"boolean[:, ::1]({_ROWS}, {_TABLE}, float64, float64)")
def hidden_edges(cameras: I64, xyxy: F64, edge_share: float, nearer_share: float) -> Bools:
    """(P, 4) whether a nearer object, whose box reaches further down, may hide each edge of each box.

    Args:
        cameras: (P,) rising.
        xyxy: (P, 4) left, top, right, bottom.
        edge_share: A box hides an edge if it covers this share of it.
        nearer_share: An object is nearer if its lower edge is further down by this share of the other one's box.
    """
    hidden, start = np.zeros((len(cameras), 4), np.bool_), 0
    for p in range(len(cameras)):
        if cameras[p] != cameras[start]:
            start = p
        left, top, right, bottom = xyxy[p, 0], xyxy[p, 1], xyxy[p, 2], xyxy[p, 3]
        width, height = right - left, bottom - top
        margin, other = nearer_share * width, start
        while other < len(cameras) and cameras[other] == cameras[p]:
            other_left, other_top, other_right, other_bottom = xyxy[other]
            if other_bottom > bottom + nearer_share * height:
                if min(bottom, other_bottom) - max(top, other_top) >= edge_share * height:
                    hidden[p, 0] |= other_left < left - margin and other_right > left - margin
                    hidden[p, 2] |= other_right > right + margin and other_left < right + margin
                if min(right, other_right) - max(left, other_left) >= edge_share * width:
                    hidden[p, 3] |= other_top < bottom
            other += 1
    return hidden


@compiled(
    "Tuple((float64[::1], float64[::1], float64[::1], float64[::1], float64[:, ::1]))"
    f"({_BLOCK}, {_TABLE}, {_TABLE}, {_TABLE}, {_MASK}, {_MASK}, {_LIST})"
)
def extents_seen(
    rays: F64, runs: F64, bearings: F64, xyxy: F64, cut: Bools, hidden: Bools, noise: F64
) -> tuple[F64, F64, F64, F64, F64]:
    """The fields of `Observed`.

    Args:
        rays: (P, 8, 3) see `Sightings`.
        runs: (P, 8) their horizontal lengths.
        bearings: (P, 8) their bearings.
        xyxy: (P, 4) the boxes, pixels.
        cut: (P, 4) whether the border of the image cuts each edge.
        hidden: (P, 4) whether another object may hide it.
        noise: (4,) variance of an edge in pixels, that as a share of the area, and those of cut and of hidden edges, as
            shares of the box.
    """
    count = len(rays)
    left, width, lower, upper = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    stds = np.empty((count, 4))
    for p in range(count):
        left[p], width[p] = bearings[p, 7], _wrapped(bearings[p, 7] - bearings[p, 3])
        lower[p], upper[p] = rays[p, 5, 2] / max(runs[p, 5], 1e-9), rays[p, 1, 2] / max(runs[p, 1], 1e-9)
        area = (xyxy[p, 2] - xyxy[p, 0]) * (xyxy[p, 3] - xyxy[p, 1])
        for edge in range(4):
            extent_px = xyxy[p, 2 + edge % 2] - xyxy[p, edge % 2]
            variance = (noise[0] + noise[1] * area) / (extent_px * extent_px)
            variance += noise[2] if cut[p, edge] else noise[3] if hidden[p, edge] else 0.0
            stds[p, edge] = (abs(width[p]) if edge % 2 == 0 else abs(upper[p] - lower[p])) * math.sqrt(variance)
    return left, width, lower, upper, stds
