"""Runs ONNX files that anyone may have made, in bounded memory.

onnxruntime itself sees to it that weights outside of a model's folder are not read, by links neither. It does not bound
what a network may take: a file of a few hundred bytes can hold a constant of many gigabytes.
"""

import os
from collections.abc import Mapping
from copy import copy
from pathlib import Path
from typing import Self

import numpy as np

from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.errors import ModelError, is_short_memory
from lidcam.pipeline.core.settings.detect import Provider
from lidcam.pipeline.core.small_files import LFS_POINTER, LFS_REMEDY
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.onnx.free_size import free_size
from lidcam.pipeline.detectors.onnx.inputs import Value
from lidcam.pipeline.detectors.onnx.providers import check_runs_on, chosen, onnxruntime, set_up

MAX_BATCH_BYTES = 1 << 29
"""Maximum size of the images given at once: 27 of 1280 x 1280 px."""

MAX_CHANGED_BYTES = 1 << 29
"""Maximum size of a file whose input is made free, which is in memory three times meanwhile; the largest YOLOX has
400 MB."""

WEIGHTS_FOLDER = "session.model_external_initializers_file_folder_path"


class OnnxSession:
    """A loaded network; may be run from several threads at once.

    Attributes:
        inputs: Name, shape and type of each input.
        outputs: The same of each output.
        metadata: Metadata of the file.
        provider: What runs it.
    """

    def __init__(self, path: Path, *, provider: Provider = "cpu", remedy: str = "") -> None:
        """Load a network, which runs on one thread: the other cores have other frames, and results stay the same.

        Args:
            path: Its file.
            provider: Processor or accelerator.
            remedy: Advice in the error if there is no such file.

        Raises:
            ModelError: the file does not exist, onnxruntime cannot load it, or it has no such provider.
        """
        if not str(path).isascii() and os.fsencode(path).decode(errors="ignore") != str(path):
            raise ModelError(f"{path}: expected a path in UTF-8, as onnxruntime needs it; rename it")
        if path.suffix in {".pt", ".pth"}:
            raise ModelError(
                f"{path}: expected ONNX, found a PyTorch checkpoint; export it first: for Ultralytics, yolo export "
                f"model={path.name} format=onnx"
            )
        try:
            if not path.is_file():
                found = "a folder" if path.is_dir() else "; ".join(filter(None, ("no such file", remedy)))
                raise ModelError(f"{path}: expected an ONNX file, found {found}")
        except OSError as err:
            raise ModelError(f"{path}: expected an ONNX file that can be read: {err.strerror}") from err
        self._path, self.provider = path, chosen(provider)
        self._load(str(path))

    def with_free_size(self, image_input: str) -> Self:
        """The same network, loaded so that the images of an input may have any size; whether they can, a run shows.

        Raises ModelError if the file is too large or has no such input, or the network cannot be loaded.
        """
        try:
            if self._path.stat().st_size > MAX_CHANGED_BYTES:
                raise ModelError(f"{self._path}: expected a file of {MAX_CHANGED_BYTES >> 20} MiB at most to change it")
            data = self._path.read_bytes()
        except OSError as err:
            raise ModelError(f"{self._path}: expected an ONNX file that can be read: {err.strerror}") from err
        changed = copy(self)
        changed._load(free_size(data, image_input))
        return changed

    def _load(self, model: str | bytes) -> None:
        """Load the network from its file, or from bytes that stand for it."""
        path, ort = self._path, onnxruntime()
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4  # errors are raised; onnxruntime would also print them
        # Idle threads would otherwise spin after each run and take cores from the other stages.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.add_session_config_entry("session.use_env_allocators", "1")
        if isinstance(model, bytes):  # weights in other files lie beside it all the same
            options.add_session_config_entry(WEIGHTS_FOLDER, str(path.resolve().parent))
        providers = set_up(self.provider, options)
        try:
            # The fallback would print, and try the same once more.
            self._session = ort.InferenceSession(model, options, providers=providers, enable_fallback=0)
        except Exception as err:  # onnxruntime's errors have no base of their own
            if is_short_memory(err):
                raise
            with path.open("rb") as stream:
                is_pointer = stream.read(len(LFS_POINTER)) == LFS_POINTER
            found = LFS_REMEDY if is_pointer else one_line(err)
            raise ModelError(f"{path}: expected an ONNX file that onnxruntime can load: {found}") from err
        check_runs_on(self.provider, self._session.get_providers())
        self.inputs: list[Value] = [(value.name, value.shape, value.type) for value in self._session.get_inputs()]
        self.outputs: list[Value] = [(value.name, value.shape, value.type) for value in self._session.get_outputs()]
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def run(self, fed: Mapping[str, Array], images: int) -> list[Array]:
        """The outputs for a batch of some images, from the array of each input by name.

        Raises ModelError if the network fails, takes too much memory, or gives no arrays.
        """
        try:
            return [np.asarray(output) for output in self._session.run(None, dict(fed))]
        except Exception as err:  # onnxruntime's errors have no base of their own
            if is_short_memory(err):
                raise
            raise ModelError(f"{self._path}: the network fails on a batch of {images}: {one_line(err)}") from err
