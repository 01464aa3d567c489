"""2D detection by a YOLOX network (Ge et al., arXiv:2107.08430) in an ONNX file.

The layout is that of Megvii's export: one input (N, 3, H, W) float32, BGR 0..255, the image scaled to fit, top left on
a background of 114; one output (N, A, 85) with one row per cell of the grids of stride 8, 16 and 32: box centre and
size, objectness, 80 COCO class scores. Centre and size are either raw (offset from the cell and logarithm, in cells)
or, after an export with `--decode_in_inference`, in pixels. A trial run when loading finds out which.

The network always runs on the CPU, so that results do not depend on the machine's accelerators.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from pipeline.core.arrays import F32, U8
from pipeline.core.errors import ModelError
from pipeline.core.settings.config import Config
from pipeline.detectors.onnx.coco import COCO_LABELS
from pipeline.detectors.onnx.session import MAX_BATCH_BYTES, OnnxSession
from pipeline.detectors.protocols import Candidates2D

__all__ = ["OnnxDetector2D"]


STRIDES_PX = (8, 16, 32)
PADDING = 114.0
COLUMNS = 5 + len(COCO_LABELS)
EXPECTED = (
    f"expected the YOLOX layout: one input (N, 3, H, W) float32 with H and W multiples of {STRIDES_PX[-1]}, "
    f"one output (N, A, {COLUMNS}) float32 with A = HW/64 + HW/256 + HW/1024"
)


class OnnxDetector2D:
    """A loaded network; may be called from several threads at once."""

    def __init__(self, path: Path, config: Config) -> None:
        """Load a network and run it once.

        Args:
            path: ONNX file.
            config: Settings; only `detect2d.threads` is used.

        Raises:
            ModelError: the file does not exist, is not an ONNX file, is not a YOLOX, or the trial fails.
        """
        self._path = path
        self._session = OnnxSession(path, config.detect2d.threads)
        self._batch, self._height_px, self._width_px = _input_layout(path, self._session)
        self._grid, self._stride = _anchors(self._height_px, self._width_px)
        trial = self._run(np.full((self._batch or 2, 3, self._height_px, self._width_px), PADDING, np.float32))
        if not np.isfinite(trial).all():
            raise ModelError(f"{path}: expected numbers, found an output that is not finite; export the network again")
        # Raw centres are a few cells at most; centres in pixels span the whole image, whatever its content.
        self._decoded = float(trial[..., :2].max()) > min(self._height_px, self._width_px) / 2

    @property
    def labels(self) -> tuple[str, ...]:
        """COCO names."""
        return COCO_LABELS

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image, in order.

        All images run in one batch if the batch dimension is free. A network with a fixed batch size B runs once per
        B images, with the last batch filled up with blank ones.

        Args:
            images: (H, W, 3) RGB, of any size each.

        Raises:
            ModelError: the network fails.
        """
        size = self._batch or max(len(images), 1)
        found: list[Candidates2D] = []
        for start in range(0, len(images), size):
            found += self._detect(images[start : start + size], size)
        return found

    def _detect(self, images: Sequence[U8], size: int) -> list[Candidates2D]:
        batch = np.full((size, 3, self._height_px, self._width_px), PADDING, np.float32)
        scales = [_letterbox(image, into) for image, into in zip(images, batch, strict=False)]
        rows = self._run(batch)
        return [self._decode(row, scale) for row, scale in zip(rows, scales, strict=False)]

    def _run(self, batch: F32) -> F32:
        (rows,) = self._session.run(batch)
        expected = (len(batch), len(self._grid), COLUMNS)
        if rows.shape != expected or rows.dtype != np.float32:
            raise ModelError(f"{self._path}: {EXPECTED}; here {expected}, found an output {rows.shape} {rows.dtype}")
        return np.asarray(rows, np.float32)

    def _decode(self, rows: F32, scale: F32) -> Candidates2D:
        """Proposals for one image from the network's rows (A, 85); `scale` is network pixels per image pixel."""
        if self._decoded:
            center, size = rows[:, :2], rows[:, 2:4]
        else:
            with np.errstate(over="ignore"):  # boxes that are not finite are left out
                center, size = (rows[:, :2] + self._grid) * self._stride, np.exp(rows[:, 2:4]) * self._stride
        xyxy = np.concatenate([center - size / 2, center + size / 2], 1) / np.tile(scale, 2)
        labels = rows[:, 5:].argmax(1)
        scores = rows[:, 4] * np.take_along_axis(rows[:, 5:], labels[:, None], 1)[:, 0]
        return Candidates2D(xyxy.astype(np.float32, copy=False), scores, labels)


def _input_layout(path: Path, session: OnnxSession) -> tuple[int | None, int, int]:
    """Batch size (None if free), height and width in pixels."""
    inputs, outputs = session.inputs, session.outputs
    match inputs:
        case [(_, [batch, 3, int(height), int(width)], "tensor(float)")] if (
            len(outputs) == 1 and height > 0 and width > 0 and height % STRIDES_PX[-1] == width % STRIDES_PX[-1] == 0
        ):
            size = batch if isinstance(batch, int) and batch > 0 else None
            if (taken := (size or 2) * 12 * height * width) > MAX_BATCH_BYTES:
                raise ModelError(
                    f"{path}: an input of {size or 2} x 3 x {height} x {width} px takes {taken / 2**30:.3g} GiB, "
                    f"expected at most {MAX_BATCH_BYTES / 2**30:g} GiB"
                )
            return size, height, width
    found = ", ".join(f"{name} {tuple(shape)} {kind}" for name, shape, kind in [*inputs, *outputs])
    raise ModelError(f"{path}: {EXPECTED}; found {found}")


def _anchors(height_px: int, width_px: int) -> tuple[F32, F32]:
    """Column and row of the cell (A, 2) and stride in pixels (A, 1) of each row of the output."""
    grids, strides = [], []
    for stride in STRIDES_PX:
        row, column = np.indices((height_px // stride, width_px // stride))
        grids.append(np.stack([column.ravel(), row.ravel()], 1))
        strides.append(np.full((row.size, 1), stride))
    return np.concatenate(grids).astype(np.float32), np.concatenate(strides).astype(np.float32)


def _letterbox(image: U8, into: F32) -> F32:
    """Scale an image into the top left of a network input (3, H, W), RGB to BGR, and return the scales in x and y (2,).

    The scaled size is truncated to whole pixels, as in YOLOX; the scales are those of the truncated size.
    """
    height, width = image.shape[:2]
    ratio = min(into.shape[1] / height, into.shape[2] / width)
    size = np.maximum([int(width * ratio), int(height * ratio)], 1)
    small = cv2.resize(image, (int(size[0]), int(size[1])), interpolation=cv2.INTER_LINEAR)
    into[:, : size[1], : size[0]] = small[..., ::-1].transpose(2, 0, 1)
    return (size / [width, height]).astype(np.float32)
