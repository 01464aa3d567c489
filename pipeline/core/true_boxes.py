"""Recorded truth, to be drawn beside the results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import F64, check_array


@dataclass(frozen=True, slots=True, eq=False)
class TrueBoxes:
    """The objects of one message of the truth."""

    topic: str  # Topic of the message
    stamp_ns: int  # Its stamp
    log_time_ns: int  # When it was recorded
    frame_id: str  # Frame of `centers`
    centers: F64  # (N, 3) float64, centre of the box, metres
    sizes: F64  # (N, 3) float64, length, width, height, metres
    yaws: F64  # (N,) float64, about +z
    labels: Sequence[str]  # Of each object: its class, as the truth names it

    def __post_init__(self) -> None:
        n = len(self.labels)
        check_array("centers", self.centers, (n, 3), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)

    def none_at(self, stamp_ns: int) -> Self:
        """No objects, of the same topic, at another time."""
        nothing = np.zeros((0, 3))
        return replace(self, stamp_ns=stamp_ns, centers=nothing, sizes=nothing, yaws=np.zeros(0), labels=())
