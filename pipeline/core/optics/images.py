"""Decoded images."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import U8, check_array


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """One image."""

    stamp_ns: int  # Time of exposure
    frame_id: str  # Camera optical frame
    rgb: U8  # (H, W, 3) uint8, red first

    def __post_init__(self) -> None:
        check_array("rgb", self.rgb, (*self.rgb.shape[:2], 3), np.uint8)
