"""Layouts with a row for each cell of grids over the image: YOLOX, YOLOv5 and its kin, YOLOv8 and its kin."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lidcam.pipeline.core.arrays import F32, Array
from lidcam.pipeline.detectors.onnx.layouts.layout import Size, best_class, check_shape, corners_of
from lidcam.pipeline.detectors.protocols import Candidates2D

STRIDES_PX = (8, 16, 32)


@dataclass(frozen=True, slots=True)
class YoloxReader:
    """YOLOX (Ge et al., arXiv:2107.08430): (N, A, 5 + C), one row per cell of the grids of stride 8, 16 and 32.

    Centre and size, objectness, C scores. Centre and size are either raw (offset from the cell and logarithm, in
    cells) or, after an export with `--decode_in_inference`, in pixels.

    Attributes:
        class_count: C.
        is_in_pixels: Whether centre and size are in pixels.
    """

    class_count: int
    is_in_pixels: bool

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        check_shape(outputs[0], (count, cell_count(size_px), 5 + self.class_count), "a YOLOX output")
        return [self._read(rows, size_px, min_score) for rows in outputs[0]]

    def _read(self, rows: F32, size_px: Size, min_score: float) -> Candidates2D:
        taken = np.flatnonzero(rows[:, 4] >= min_score)
        rows = rows[taken]
        centers, sizes = rows[:, :2], rows[:, 2:4]
        if not self.is_in_pixels:
            grid, stride = (cells[taken] for cells in cells_of(size_px))
            centers, sizes = (centers + grid) * stride, np.exp(sizes) * stride
        scores, labels = best_class(rows[:, 5:])
        return Candidates2D(corners_of(centers, sizes), rows[:, 4] * scores, labels)


@dataclass(frozen=True, slots=True)
class YoloV5Reader:
    """YOLOv5, YOLOv6, YOLOv7: (N, A, 5 + C), rows of centre and size in pixels, objectness, C scores.

    Attributes:
        class_count: C.
    """

    class_count: int

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del size_px
        check_shape(outputs[0], (count, None, 5 + self.class_count), "a YOLOv5 output")
        return [self._read(rows[rows[:, 4] >= min_score]) for rows in outputs[0]]

    @staticmethod
    def _read(rows: F32) -> Candidates2D:
        scores, labels = best_class(rows[:, 5:])
        return Candidates2D(corners_of(rows[:, :2], rows[:, 2:4]), rows[:, 4] * scores, labels)


@dataclass(frozen=True, slots=True)
class YoloV8Reader:
    """YOLOv8, YOLOv9, YOLO11, YOLO12: (N, 4 + C, A), columns of centre and size in pixels, C scores.

    Attributes:
        class_count: C.
    """

    class_count: int

    def __call__(self, outputs: Sequence[Array], count: int, size_px: Size, min_score: float) -> list[Candidates2D]:
        """See `Reader`."""
        del size_px
        check_shape(outputs[0], (count, 4 + self.class_count, None), "a YOLOv8 output")
        return [self._read(columns[:, columns[4:].max(0) >= min_score].T) for columns in outputs[0]]

    @staticmethod
    def _read(rows: F32) -> Candidates2D:
        scores, labels = best_class(rows[:, 4:])
        return Candidates2D(corners_of(rows[:, :2], rows[:, 2:4]), scores, labels)


def cell_count(size_px: Size, strides_px: Sequence[int] = STRIDES_PX) -> int:
    """Cells of the grids of all strides."""
    return sum((size_px[0] // stride) * (size_px[1] // stride) for stride in strides_px)


def is_in_pixels(rows: F32, size_px: Size) -> bool:
    """Whether a YOLOX gives centres in pixels, from its output (N, A, 5 + C) for blank images.

    Raw centres are a few cells at most; centres in pixels span the whole image, whatever its content.
    """
    return float(rows[..., :2].max()) > min(size_px) / 2


@lru_cache(maxsize=32)
def cells_of(size_px: Size) -> tuple[F32, F32]:
    """Column and row of the cell (A, 2) and stride in pixels (A, 1) of each row of the output."""
    grids, strides = [], []
    for stride in STRIDES_PX:
        row, column = np.indices((size_px[0] // stride, size_px[1] // stride))
        grids.append(np.stack([column.ravel(), row.ravel()], 1))
        strides.append(np.full((row.size, 1), stride))
    return np.concatenate(grids).astype(np.float32), np.concatenate(strides).astype(np.float32)
