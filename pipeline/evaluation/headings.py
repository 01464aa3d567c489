"""When a heading points the wrong way."""

import numpy as np
import numpy.typing as npt

from pipeline.core.arrays import Bools

__all__ = ["is_flip"]

_MAX_TURN_RAD = np.pi / 2 + 1e-6
"""A right angle, which is no flip, and what single precision may add to it."""


def is_flip(turns_rad: npt.NDArray[np.floating]) -> Bools:
    """Whether turns (N,) between two headings, in [-pi, pi], are of more than 90 degrees to either side."""
    return np.asarray(np.abs(turns_rad) > _MAX_TURN_RAD)
