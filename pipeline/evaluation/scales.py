"""Distances, ranges and turns by which results are judged: scaled to the objects' length."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.settings.config import Config

REFERENCE_LENGTH_M = 4.0
"""Length of the car for which the distances of nuScenes were chosen."""

RANGES_M = (0.0, 10.0, 20.0, 40.0, 80.0)
"""Edges of the ranges from the origin of the site frame, for a first class as long as a car."""

MAX_TURN_RAD = np.pi / 2 + 1e-6
"""Largest turn that is no flip: a right angle and its rounding in single precision."""


def is_flip(turns_rad: npt.NDArray[np.floating]) -> Bools:
    """(N,) whether turns in [-pi, pi] exceed 90 degrees to either side."""
    return np.asarray(np.abs(turns_rad) > MAX_TURN_RAD)


def length_scales(config: Config) -> F64:
    """(C,) factors of nuScenes's distances: a class's length over 4 m."""
    return np.array([prior.size_m[0] for prior in config.classes]) / REFERENCE_LENGTH_M


def range_edges_m(config: Config) -> F64:
    """(K,) starts of the K ranges from the origin that have figures of their own, metres; the last has no end."""
    return np.array(RANGES_M) * (config.classes[0].size_m[0] / REFERENCE_LENGTH_M)


def ranges_m(centers: F64) -> F64:
    """(N,) distances along the ground of centres (N, 3) from the origin of the site frame, metres."""
    return np.hypot(centers[:, 0], centers[:, 1])


def range_names(edges_m: F64) -> tuple[str, ...]:
    """(K,) names of the ranges in figures, as `0_10` and `over_80`."""
    closed = (f"{decimal(near)}_{decimal(far)}" for near, far in pairwise(edges_m.tolist()))
    return (*closed, f"over_{decimal(float(edges_m[-1]))}")


def range_rows(distances_m: F64, edges_m: F64) -> I64:
    """(N,) row of the range that holds each distance along the ground; -1 before the first.

    A range holds its nearer edge and not its farther one; `edges_m` (K,) rise.
    """
    return (np.searchsorted(edges_m, distances_m, side="right") - 1).astype(np.int64)


def decimal(number: float) -> str:
    """A number in the name of a figure, where a point would part two names: `0.825` is `0p825`."""
    return f"{number:.6g}".replace(".", "p")
