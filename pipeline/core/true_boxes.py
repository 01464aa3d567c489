"""Recorded truth, to be drawn beside the results."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, check_array


@dataclass(frozen=True, slots=True, eq=False)
class TrueBoxes:
    """The objects of one message of the truth.

    Attributes:
        topic: Topic of the message.
        stamp_ns: Its stamp.
        log_time_ns: When it was recorded.
        frame_id: Frame of `centers`.
        centers: (N, 3) float64, centre of the box, metres.
        sizes: (N, 3) float64, length, width, height, metres.
        yaws: (N,) float64, about +z.
        labels: Of each object: its class, as the truth names it.
    """

    topic: str
    stamp_ns: int
    log_time_ns: int
    frame_id: str
    centers: F64
    sizes: F64
    yaws: F64
    labels: Sequence[str]

    def __post_init__(self) -> None:
        n = len(self.labels)
        check_array("centers", self.centers, (n, 3), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)
