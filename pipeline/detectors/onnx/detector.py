"""2D detection by a network in an ONNX file.

A trial run when loading shows which layout the network has (`layouts.py`), and a second one whether it takes images of
other sizes than its own. Networks of convolutions do, whatever their file says.
"""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F32, U8, Array
from lidcam.pipeline.core.errors import ConfigError, ModelError
from lidcam.pipeline.core.settings.detect import Detect2DConfig
from lidcam.pipeline.detectors.onnx.class_names import class_names
from lidcam.pipeline.detectors.onnx.inputs import input_size, read_inputs
from lidcam.pipeline.detectors.onnx.layouts import Layout, Size, Trial, recognise
from lidcam.pipeline.detectors.onnx.preprocessing import Preprocessing
from lidcam.pipeline.detectors.onnx.session import MAX_BATCH_BYTES, OnnxSession
from lidcam.pipeline.detectors.onnx.tiles import Tile, join_tiles, tiles_of
from lidcam.pipeline.detectors.protocols import Candidates2D

logger = logging.getLogger(__name__)

STRIDE_PX = 32
"""Common divisor of heights and widths where the file says nothing."""

MAX_STRIDE_PX = 128

USUAL_PX: Size = (640, 640)
"""Height and width where the file says nothing."""

PROBE_CELLS = (5, 7), (6, 8)
"""Heights and widths in strides that show whether a network takes other sizes: one of them has another number of cells
than the network's own, so that a table for the own size does not fit."""

PIXEL_BYTES = 12

CACHED_BYTES = 1 << 22
"""Maximum size of a batch of several images on a processor: the layers of a larger one leave the caches before the next
layer reads them, which costs YOLOX-nano a fifth."""

MAX_OUTPUT_BYTES = 1 << 29
"""Maximum size of one output for one batch: more is no detection."""


class OnnxDetector2D:
    """A loaded network; may be called from several threads at once.

    Attributes:
        labels: Names of the network's classes.
    """

    def __init__(self, path: Path, settings: Detect2DConfig) -> None:
        """Load a network and try it.

        Raises ConfigError if the file with the names of classes cannot be read, and ModelError if the network's does
        not exist or is no ONNX file, its layout or the names of its classes are not known, a trial fails, or it does
        not take the size that is set.
        """
        self._path, self._settings = path, settings
        remedy = "lidcam fetch yolox-nano downloads one"
        self._session = OnnxSession(path, provider=settings.provider, remedy=remedy)
        try:
            self._load()
        except (ConfigError, ModelError) as err:
            if str(path) in str(err):
                raise
            raise type(err)(f"{path}: {err}") from err

    def _load(self) -> None:
        settings, metadata = self._settings, self._session.metadata
        if (task := metadata.get("task", "detect")) != "detect":
            raise ModelError(f"expected a network for detection, found one for the task {task[:40]!r}")
        self._inputs = read_inputs(self._session.inputs)
        self._stride_px = _stride_px(metadata)
        usual_px = _size_px(metadata)
        own_px = self._inputs.height_px or usual_px[0], self._inputs.width_px or usual_px[1]
        self._layout = self._try(self._session, own_px)
        self.labels = class_names(settings.names, metadata, self._layout.class_count)
        self._preprocessing = Preprocessing(
            self._layout.colors if settings.colors == "auto" else settings.colors, self._layout.placement
        )
        self._fixed_px: Size | None = own_px
        self._free_size(own_px, None if settings.input == "auto" else (settings.input[1], settings.input[0]))
        size = f"images in their own shape, {settings.max_input_px} px at most"
        if self._fixed_px:
            size = f"images of {self._fixed_px[1]} x {self._fixed_px[0]} px"
        logger.info("%s: %s, %d classes, %s", self._path, self._layout.name, len(self.labels), size)

    def __call__(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image, in order.

        Images (H, W, 3) of one input size run in one batch if the batch dimension is free; on the processor only as
        many as its caches hold, so that large ones run one by one. A network with a fixed batch size B runs once per B
        images, with the last batch filled up with blank ones. For a network with a fixed size, images of another shape
        become tiles (`tiles_of`). Raises ModelError if the network fails, or finds a class that has no name.
        """
        tiles = [self._tiles(image) for image in images]
        found = iter(self._detect_all([t.cut(image) for image, its in zip(images, tiles, strict=True) for t in its]))
        return [join_tiles([next(found) for _ in its], its, min_score=self._settings.min_score) for its in tiles]

    def _tiles(self, image: U8) -> list[Tile]:
        """The parts of an image that are given one by one: all of it, unless the size is fixed by the network alone."""
        height_px, width_px = image.shape[:2]
        if self._fixed_px is None or self._settings.input != "auto":
            return [Tile(0, 0, width_px, height_px)]
        return tiles_of(height_px, width_px, self._fixed_px, self._settings.max_input_px)

    def _detect_all(self, images: Sequence[U8]) -> list[Candidates2D]:
        """Proposals for each image or tile, in order."""
        of_size: dict[Size, list[int]] = {}
        for row, image in enumerate(images):
            of_size.setdefault(self._size_for(image), []).append(row)
        found: dict[int, Candidates2D] = {}
        room_bytes = CACHED_BYTES if self._session.provider == "cpu" else MAX_BATCH_BYTES
        for size_px, rows in of_size.items():
            most = self._inputs.batch or max(room_bytes // (PIXEL_BYTES * size_px[0] * size_px[1]), 1)
            for start in range(0, len(rows), most):
                chosen = rows[start : start + most]
                found |= zip(chosen, self._detect([images[row] for row in chosen], size_px), strict=True)
        return [found[row] for row in range(len(images))]

    def _size_for(self, image: U8) -> Size:
        """Height and width of the network's input for an image."""
        if self._fixed_px:
            return self._fixed_px
        height_px, width_px = image.shape[:2]
        max_px = self._settings.max_input_px
        width_px, height_px = input_size(width_px, height_px, max_px=max_px, stride_px=self._stride_px)
        return height_px, width_px

    def _detect(self, images: Sequence[U8], size_px: Size) -> list[Candidates2D]:
        batch = np.empty((self._inputs.batch or len(images), 3, *size_px), np.float32)
        places = [self._preprocessing.put(image, into) for image, into in zip(images, batch, strict=False)]
        batch[len(images) :] = self._preprocessing.grey
        outputs = self._run(self._session, batch)
        try:
            with np.errstate(all="ignore"):
                found = self._layout.read(outputs, len(batch), size_px, self._settings.min_score)[: len(images)]
                found = [one._replace(xyxy=place.undo(one.xyxy)) for one, place in zip(found, places, strict=True)]
        except ModelError as err:
            raise ModelError(f"{self._path}: {err}") from err
        last = max((int(one.labels.max(initial=0)) for one in found), default=0)
        if last >= len(self.labels):
            raise ModelError(
                f"{self._path}: the network finds the class {last}, and there are names for {len(self.labels)}: "
                "set detect2d.names to all of its names"
            )
        return found

    def _run(self, session: OnnxSession, batch: F32) -> list[Array]:
        """The outputs, real ones as float32; raises ModelError if the network fails, or gives others, or too many."""
        outputs = session.run(self._inputs.feed(batch), len(batch))
        for (name, _, kind), output in zip(session.outputs, outputs, strict=True):
            if output.dtype.kind not in "fiu" or output.nbytes > MAX_OUTPUT_BYTES:
                raise ModelError(
                    f"{self._path}: expected numbers, {MAX_OUTPUT_BYTES >> 20} MiB at most, found an output {name} "
                    f"{output.shape} {kind}"
                )
        return [output.astype(np.float32, copy=False) if output.dtype.kind == "f" else output for output in outputs]

    def _try(self, session: OnnxSession, size_px: Size) -> Layout:
        """Run a network on blank images; the layout of what it gives."""
        count, (height_px, width_px) = self._inputs.batch or 2, size_px
        if (taken := count * PIXEL_BYTES * height_px * width_px) > MAX_BATCH_BYTES:
            raise ModelError(
                f"an input of {count} x 3 x {height_px} x {width_px} px takes {taken / 2**30:.3g} GiB, "
                f"expected at most {MAX_BATCH_BYTES / 2**30:g} GiB"
            )
        # Grey as 114 / 255, which no network takes for a light too bright: half precision ends at 65504.
        outputs = self._run(session, Preprocessing("rgb_1", "top_left").blank(count, height_px, width_px))
        if not all(np.isfinite(output).all() for output in outputs):
            raise ModelError("expected numbers, found an output that is not finite; export the network again")
        names = [name for name, _, _ in session.outputs]
        wanted = None if self._settings.layout == "auto" else self._settings.layout
        layout = recognise(Trial(size_px, names, outputs, self._inputs.sizes is not None), wanted)
        with np.errstate(all="ignore"):
            layout.read(outputs, count, size_px, self._settings.min_score)
        return layout

    def _free_size(self, own_px: Size, wanted_px: Size | None) -> None:
        """Let the network take images of another size than its own, or of any (None), if it can and is made to.

        Raises ModelError if it does not take the size that is wanted.
        """
        is_free = self._inputs.height_px is None and self._inputs.width_px is None
        made_for_one_size = self._layout.placement == "stretched" and not is_free
        if wanted_px == own_px or (wanted_px is None and made_for_one_size):
            return
        if wanted_px and any(size % self._stride_px for size in wanted_px):
            found = f"{wanted_px[1]} x {wanted_px[0]}"
            raise ModelError(f"detect2d.input: expected multiples of {self._stride_px} px, found {found}")
        # A small size with another number of cells than the network's own.
        probes = [(rows * self._stride_px, columns * self._stride_px) for rows, columns in PROBE_CELLS]
        probe_px = next(probe for probe in probes if np.prod(probe) != np.prod(own_px))
        own = f"{own_px[1]} x {own_px[0]} px"
        try:
            session = self._session if is_free else self._session.with_free_size(self._inputs.images)
            for size_px in (probe_px, *([wanted_px] if wanted_px else [])):
                self._check_layout(self._try(session, size_px), size_px)
        except ModelError as err:
            if wanted_px:
                raise ModelError(
                    f"detect2d.input: the network does not take {wanted_px[1]} x {wanted_px[0]} px, its own size is "
                    f"{own}: {err}"
                ) from err
            logger.info("%s takes %s only: %s", self._path, own, err)
            return
        self._session, self._fixed_px = session, wanted_px

    def _check_layout(self, found: Layout, size_px: Size) -> None:
        if (found.name, found.class_count) != (self._layout.name, self._layout.class_count):
            at = f"{size_px[1]} x {size_px[0]} px"
            raise ModelError(f"expected the layout {self._layout.name}, found {found.name} for {at}")


def _stride_px(metadata: dict[str, str]) -> int:
    """Width and height are multiples of it."""
    stride = metadata.get("stride", "")
    return min(max(int(stride), STRIDE_PX), MAX_STRIDE_PX) if stride.isdecimal() and len(stride) < 5 else STRIDE_PX


def _size_px(metadata: dict[str, str]) -> Size:
    """Height and width that the network was exported for; the usual ones where its file does not say."""
    found = re.fullmatch(r"\[(\d{2,4}), (\d{2,4})\]", metadata.get("imgsz", ""))
    return (int(found[1]), int(found[2])) if found else USUAL_PX
