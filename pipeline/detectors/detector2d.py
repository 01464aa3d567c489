"""What a 2D engine hands to the detect2d stage: every box that a network proposes, before any of them is sorted out."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from pipeline.core.arrays import F32, I64, U8

__all__ = ["Candidates2D", "Detector2D"]


class Candidates2D(NamedTuple):
    """Proposals for one image, in the network's own order.

    Attributes:
        xyxy: (A, 4) float32, left, top, right, bottom in pixels of the image as it was given; may reach beyond it.
        scores: (A,) float32 in [0, 1].
        labels: (A,) int64, row of the detector's `labels`.
    """

    xyxy: F32
    scores: F32
    labels: I64


class Detector2D(Protocol):
    """An engine that proposes boxes for images."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of what it can find."""

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image, (H, W, 3) RGB of any size, in order."""
