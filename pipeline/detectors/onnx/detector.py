"""2D detection by a YOLOX network (Ge et al., arXiv:2107.08430) in an ONNX file.

The layout is that of Megvii's export: one input (N, 3, H, W) float32, BGR 0..255, the image scaled to fit, top left on
a background of 114; one output (N, A, 85) with one row per cell of the grids of stride 8, 16 and 32: box centre and
size, objectness, 80 COCO class scores. Centre and size are either raw (offset from the cell and logarithm, in cells)
or, after an export with `--decode_in_inference`, in pixels. A trial run when loading finds out which.

The network always runs on the CPU, so that results do not depend on the machine's accelerators.
"""

import logging
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from pipeline.core.arrays import F32, U8
from pipeline.core.errors import ModelError
from pipeline.core.settings.config import Config
from pipeline.core.settings.detect import Detect2DConfig
from pipeline.detectors.onnx.coco import COCO_LABELS
from pipeline.detectors.onnx.input_size import input_size
from pipeline.detectors.onnx.session import MAX_BATCH_BYTES, OnnxSession
from pipeline.detectors.protocols import Candidates2D

__all__ = ["OnnxDetector2D"]

logger = logging.getLogger(__name__)

STRIDES_PX = (8, 16, 32)
PADDING = 114.0
COLUMNS = 5 + len(COCO_LABELS)
EXPECTED = (
    f"expected the YOLOX layout: one input (N, 3, H, W) float32 with H and W multiples of {STRIDES_PX[-1]}, "
    f"one output (N, A, {COLUMNS}) float32 with A = HW/64 + HW/256 + HW/1024"
)
PROBES_PX = (160, 224), (192, 256)
"""Heights and widths that show whether a network takes other sizes; one has another number of cells than its own."""

USUAL_PX = 640, 640
"""Height and width where the file names none."""


class OnnxDetector2D:
    """A loaded network; may be called from several threads at once."""

    def __init__(self, path: Path, config: Config) -> None:
        """Load a network and run it once.

        Args:
            path: ONNX file.
            config: Settings, of which `detect2d` is used.

        Raises:
            ModelError: the file does not exist, is not an ONNX file, is not a YOLOX, the trial fails, or it does not
                take the size that is set.
        """
        self._path, self._config = path, config.detect2d
        self._session = OnnxSession(path, self._config.threads)
        self._batch, *declared = _input_layout(path, self._session)
        height_px, width_px = (size or usual for size, usual in zip(declared, USUAL_PX, strict=True))
        self._decoded = self._try(self._session, height_px, width_px)
        self._fixed_px: tuple[int, int] | None = (height_px, width_px)
        if self._config.input != (width_px, height_px):
            self._free(is_declared=None in declared)
        logger.info("%s: input %s", path, _told(self._fixed_px, self._config))

    @property
    def labels(self) -> tuple[str, ...]:
        """COCO names."""
        return COCO_LABELS

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image, in order.

        All images that the network is given in one size run in one batch if the batch dimension is free. A network
        with a fixed batch size B runs once per B images, with the last batch filled up with blank ones.

        Args:
            images: (H, W, 3) RGB, of any size each.

        Raises:
            ModelError: the network fails.
        """
        found: list[Candidates2D | None] = [None] * len(images)
        of_size: dict[tuple[int, int], list[int]] = {}
        for index, image in enumerate(images):
            of_size.setdefault(self._size_for(image), []).append(index)
        for (height_px, width_px), indices in of_size.items():
            size = self._batch or min(len(indices), max(MAX_BATCH_BYTES // (12 * height_px * width_px), 1))
            for start in range(0, len(indices), size):
                chosen = indices[start : start + size]
                batch = np.full((size, 3, height_px, width_px), PADDING, np.float32)
                for index, candidates in zip(chosen, self._detect([images[i] for i in chosen], batch), strict=True):
                    found[index] = candidates
        return [candidates for candidates in found if candidates is not None]

    def _size_for(self, image: U8) -> tuple[int, int]:
        """Height and width of the network's input for an image."""
        if self._fixed_px:
            return self._fixed_px
        if self._config.input != "auto":
            return self._config.input[1], self._config.input[0]
        height, width = image.shape[:2]
        return input_size(width, height, most_px=self._config.max_input_px, stride_px=STRIDES_PX[-1])[::-1]

    def _try(self, session: OnnxSession, height_px: int, width_px: int) -> bool:
        """Run a network on blank images; whether what it gives is in pixels."""
        if (taken := (self._batch or 2) * 12 * height_px * width_px) > MAX_BATCH_BYTES:
            raise ModelError(
                f"{self._path}: an input of {self._batch or 2} x 3 x {height_px} x {width_px} px takes "
                f"{taken / 2**30:.3g} GiB, expected at most {MAX_BATCH_BYTES / 2**30:g} GiB"
            )
        trial = self._run(session, np.full((self._batch or 2, 3, height_px, width_px), PADDING, np.float32))
        if not np.isfinite(trial).all():
            raise ModelError(
                f"{self._path}: expected numbers, found an output that is not finite; export the network again"
            )
        # Raw centres are a few cells at most; centres in pixels span the whole image, whatever its content.
        return float(trial[..., :2].max()) > min(height_px, width_px) / 2

    def _free(self, *, is_declared: bool) -> None:
        """Let the network take images of other sizes, if it can.

        Raises:
            ModelError: it cannot, and a size is set.
        """
        own = self._fixed_px
        probe = next(size for size in PROBES_PX if own is None or np.prod(size) != np.prod(own))
        wanted = self._config.input
        if wanted != "auto" and (wanted[0] % STRIDES_PX[-1] or wanted[1] % STRIDES_PX[-1]):
            raise ModelError(f"detect2d.input: expected multiples of {STRIDES_PX[-1]}, found {list(wanted)}")
        try:
            session = self._session if is_declared else self._session.with_free_size()
            self._try(session, *probe)
            if wanted != "auto":
                self._try(session, wanted[1], wanted[0])
        except ModelError as err:
            if wanted != "auto":
                raise ModelError(f"detect2d.input: {list(wanted)} is not for this network: {err}") from err
            logger.info("%s takes images of its own size only: %s", self._path, err)
        else:
            self._session, self._fixed_px = session, None

    def _detect(self, images: Sequence[U8], batch: F32) -> list[Candidates2D]:
        scales = [_letterbox(image, into) for image, into in zip(images, batch, strict=False)]
        rows = self._run(self._session, batch)
        return [self._decode(row, scale, *batch.shape[2:]) for row, scale in zip(rows, scales, strict=False)]

    def _run(self, session: OnnxSession, batch: F32) -> F32:
        (rows,) = session.run(batch)
        expected = (len(batch), len(_anchors(*batch.shape[2:])[0]), COLUMNS)
        if rows.shape != expected or rows.dtype != np.float32:
            raise ModelError(f"{self._path}: {EXPECTED}; here {expected}, found an output {rows.shape} {rows.dtype}")
        return np.asarray(rows, np.float32)

    def _decode(self, rows: F32, scale: F32, height_px: int, width_px: int) -> Candidates2D:
        """Proposals for one image from the network's rows (A, 85); `scale` is network pixels per image pixel."""
        if self._decoded:
            center, size = rows[:, :2], rows[:, 2:4]
        else:
            grid, stride = _anchors(height_px, width_px)
            with np.errstate(over="ignore"):  # boxes that are not finite are left out
                center, size = (rows[:, :2] + grid) * stride, np.exp(rows[:, 2:4]) * stride
        xyxy = np.concatenate([center - size / 2, center + size / 2], 1) / np.tile(scale, 2)
        labels = rows[:, 5:].argmax(1)
        scores = rows[:, 4] * np.take_along_axis(rows[:, 5:], labels[:, None], 1)[:, 0]
        return Candidates2D(xyxy.astype(np.float32, copy=False), scores, labels)


def _told(fixed_px: tuple[int, int] | None, config: Detect2DConfig) -> str:
    if fixed_px:
        return f"{fixed_px[1]} x {fixed_px[0]} px"
    if config.input != "auto":
        return f"{config.input[0]} x {config.input[1]} px"
    return f"of each picture's shape, {config.max_input_px} px at most"


def _input_layout(path: Path, session: OnnxSession) -> tuple[int | None, int | None, int | None]:
    """Batch size, height and width in pixels; None if free."""
    inputs, outputs = session.inputs, session.outputs
    match inputs:
        case [(_, [batch, 3, height, width], "tensor(float)")] if len(outputs) == 1 and all(
            not isinstance(n, int) or n > 0 == n % STRIDES_PX[-1] for n in (height, width)
        ):
            batch, height, width = (n if isinstance(n, int) and n > 0 else None for n in (batch, height, width))
            return batch, height, width
    found = ", ".join(f"{name} {tuple(shape)} {kind}" for name, shape, kind in [*inputs, *outputs])
    raise ModelError(f"{path}: {EXPECTED}; found {found}")


@lru_cache(maxsize=32)
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
