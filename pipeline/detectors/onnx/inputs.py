"""The inputs that a network in an ONNX file takes, and which size it is given for an image."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import F32, Array
from lidcam.pipeline.core.errors import ModelError

Value = tuple[str, Sequence[int | str | None], str]
"""Name, shape and type of an input or an output."""

FLOATS: dict[str, type[np.floating[Any]]] = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True, slots=True)
class NetworkInputs:
    """Inputs of a network."""

    images: str  # Name of the input for images (N, 3, H, W)
    dtype: type[np.floating[Any]]  # Type of its numbers
    batch: int | None  # N, None if free
    height_px: int | None  # H, None if free
    width_px: int | None  # W, None if free
    sizes: str | None  # Name of the input for the widths and heights (N, 2) that boxes are wanted in; None without one

    def feed(self, batch: F32) -> Mapping[str, Array]:
        """The inputs for images (N, 3, H, W), by name: boxes are wanted in pixels of these."""
        fed: dict[str, Array] = {self.images: batch.astype(self.dtype, copy=False)}
        if self.sizes is not None:
            count, _, height_px, width_px = batch.shape
            fed[self.sizes] = np.tile(np.array([width_px, height_px], np.int64), (count, 1))
        return fed


def read_inputs(inputs: Sequence[Value]) -> NetworkInputs:
    """The inputs of a network, recognised; raises ModelError if it takes no images, or something else with them."""
    images = [(name, shape, kind) for name, shape, kind in inputs if len(shape) == 4]
    others = [(name, shape, kind) for name, shape, kind in inputs if len(shape) != 4]
    match images, others:
        case [(name, [batch, 3, height, width], kind)], [] | [(_, [_, 2], "tensor(int64)")] if kind in FLOATS:
            return NetworkInputs(
                images=name,
                dtype=FLOATS[kind],
                batch=_number(batch),
                height_px=_number(height),
                width_px=_number(width),
                sizes=others[0][0] if others else None,
            )
    raise ModelError(
        "expected one input (N, 3, H, W) of float32 or float16, and with it at most one (N, 2) of int64 for the sizes; "
        f"found {listed(inputs)}"
    )


def listed(values: Sequence[Value]) -> str:
    """Inputs or outputs, in words."""
    return ", ".join(f"{name} {tuple(shape)} {kind}" for name, shape, kind in values)


def _number(size: int | str | None) -> int | None:
    """A size that is given; one that is not positive is not."""
    return size if isinstance(size, int) and size > 0 else None


@lru_cache(maxsize=1024)
def input_size(width_px: int, height_px: int, *, max_px: int, stride_px: int) -> tuple[int, int]:
    """Width and height in pixels, multiples of the stride, that show the image largest.

    The image is scaled to fit, with its shape kept. Of all sizes of `max_px` pixels at most, this is the one with
    the largest scale, then the one with the fewest pixels, then the widest. An image is not enlarged. If the least
    size is beyond `max_px`, that is taken all the same.

    Args:
        width_px: Width of the image.
        height_px: Its height.
        max_px: Pixels of the input at most.
        stride_px: Width and height are multiples of it.
    """
    cells = max(max_px // stride_px**2, 1)
    best, chosen = (-1.0, 0), (1, 1)
    full = -(-width_px // stride_px), -(-height_px // stride_px)
    for columns in range(min(cells, full[0]), 0, -1):
        # The rows that this width needs; more would stay empty, and of fewer the height decides.
        needed = -(-columns * height_px // width_px)
        rows = max(min(cells // columns, needed, full[1]), 1)
        scale = min(columns * stride_px / width_px, rows * stride_px / height_px, 1.0)
        if (scale, -columns * rows) > best:
            best, chosen = (scale, -columns * rows), (columns, rows)
    return chosen[0] * stride_px, chosen[1] * stride_px
