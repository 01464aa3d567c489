"""Decoded images."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import U8, check_array


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One image.

    Attributes:
        stamp_ns: Time of exposure.
        frame_id: Camera optical frame.
        rgb: (H, W, 3) uint8, red first.
    """

    stamp_ns: int
    frame_id: str
    rgb: U8

    def __post_init__(self) -> None:
        check_array("rgb", self.rgb, (*self.rgb.shape[:2], 3), np.uint8)
