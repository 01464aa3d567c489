"""Parts that all layouts share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lidcam.pipeline.core.arrays import F32, I64, Array
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.settings.detect import NetworkColors, NetworkLayout
from lidcam.pipeline.detectors.onnx.preprocessing import Placement
from lidcam.pipeline.detectors.protocols import Candidates2D

Size = tuple[int, int]
"""Height and width of a network's input, pixels."""


class Reader(Protocol):
    """Reads the outputs of a network."""

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """Proposals for each image of a batch, in pixels of the network's input.

        Args:
            outputs: All outputs of the network, in its order; numbers.
            count: Images of the batch.
            size_px: Height and width of the network's input.
            min_score: Proposals with a lower score may be left out; scores are at most 1.

        Boxes that are beyond what numbers can say are not finite; a caller leaves them out, and has numpy keep quiet.

        Raises:
            ModelError: the outputs are not of the layout.
        """


@dataclass(frozen=True, slots=True)
class Layout:
    """Meaning of the inputs and outputs of a network.

    Attributes:
        name: As in the settings (`detect2d.layout`).
        colors: How it takes the colours of an image.
        placement: Where the image lies in its input.
        class_count: Classes that it tells apart; None where its outputs do not say.
        read: Reads its outputs.
    """

    name: NetworkLayout
    colors: NetworkColors
    placement: Placement
    class_count: int | None
    read: Reader


def check_shape(output: Array, expected: Sequence[int | None], what: str) -> None:
    """Whether an output has a shape; None stands for any number.

    Raises:
        ModelError: it has another one.
    """
    fits = len(output.shape) == len(expected) and all(
        wanted in (None, found) for wanted, found in zip(expected, output.shape, strict=True)
    )
    if not fits:
        shape = ", ".join("any" if wanted is None else str(wanted) for wanted in expected)
        raise ModelError(f"expected {what} of shape ({shape}), found {tuple(output.shape)}")


def best_class(scores: F32) -> tuple[F32, I64]:
    """The largest score of each row (N, C) and where it stands; of equal ones the first."""
    labels = scores.argmax(1)
    return np.take_along_axis(scores, labels[:, None], 1)[:, 0], labels


def corners_of(centers: F32, sizes: F32) -> F32:
    """Left, top, right, bottom (N, 4) of boxes by centre and size (N, 2)."""
    return np.concatenate([centers - sizes / 2, centers + sizes / 2], 1)
