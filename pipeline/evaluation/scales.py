"""Distances by which results are judged: as long as the objects are, or those of nuScenes."""

from itertools import pairwise

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.core.settings.config import Config

__all__ = ["REFERENCE_LENGTH_M", "length_scale", "range_edges_m", "range_names", "range_rows"]

REFERENCE_LENGTH_M = 4.0
"""Length of the car for which the distances of nuScenes were chosen."""

DEFAULT_RANGES_M = (0.0, 10.0, 20.0, 40.0, 80.0)


def length_scale(config: Config, class_id: int) -> float:
    """What distances of nuScenes are multiplied with for a class: its length over 4 m, or 1 where they are unscaled."""
    if config.evaluate.distances == "nuscenes":
        return 1.0
    return config.classes[class_id].size_m[0] / REFERENCE_LENGTH_M


def range_edges_m(config: Config) -> F64:
    """(K + 1,) edges of the K ranges from the origin by which figures are told apart, metres."""
    if config.evaluate.ranges_m is not None:
        return np.array(config.evaluate.ranges_m, np.float64)
    return np.array(DEFAULT_RANGES_M) * (config.classes[0].size_m[0] / REFERENCE_LENGTH_M)


def range_names(edges_m: F64) -> tuple[str, ...]:
    """Names of the ranges in figures, as `0_10`; `0p75_1p5` in a miniature, as points part the names of figures."""
    return tuple(f"{near:g}_{far:g}".replace(".", "p") for near, far in pairwise(edges_m))


def range_rows(centers: F64, edges_m: F64) -> I64:
    """The range in which each centre lies, measured along the ground.

    Args:
        centers: (N, 3) in the site frame, metres.
        edges_m: (K + 1,) rising.

    Returns:
        (N,) row of the range, -1 outside all; a range holds its nearer edge and not its farther.
    """
    rows = np.searchsorted(edges_m, np.hypot(centers[:, 0], centers[:, 1]), side="right") - 1
    return np.where(rows < len(edges_m) - 1, rows, -1).astype(np.int64)
