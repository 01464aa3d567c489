"""A small network that says what a cluster is: multi-layer perceptrons in numpy, whose probabilities are averaged."""

import zipfile
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ModelError
from lidcam.pipeline.core.small_files import read_small_file
from lidcam.pipeline.core.text import one_line
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.kinds import KINDS
from lidcam.pipeline.detectors.log_odds import softmax

EMBEDDED = Path(__file__).with_name("road.npz")
"""The weights that travel with lidcam; `road.md` beside it says how they were made."""

MAX_BYTES = 16 << 20

MAX_STANDARD = 4.0
"""Maximum distance of a feature from its mean, in standard deviations: the training has seen none beyond."""


@dataclass(frozen=True, eq=False)
class ClusterNetwork:
    """M networks of the same form."""

    mean: F64  # (F,) means of the features in training
    deviation: F64  # (F,) standard deviations
    weights: tuple[F64, ...]  # (M, inputs, outputs) for each layer
    biases: tuple[F64, ...]  # (M, 1, outputs) for each layer

    def __call__(self, features: F64) -> F64:
        """(B, 5) probability of each of `KINDS`, for features (B, F)."""
        values = self.standard(features)[None]
        for row, (weights, biases) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = (np.maximum(values, 0.0) if row else values) @ weights + biases
        return np.asarray(softmax(values).mean(0))

    def standard(self, features: F64) -> F64:
        """Features (B, F) as the first layer takes them."""
        return np.asarray(((features - self.mean) / self.deviation).clip(-MAX_STANDARD, MAX_STANDARD))

    def to_bytes(self) -> bytes:
        """The content of a file, an archive of arrays of numpy; the same network makes the same bytes."""
        numbers = {"mean": self.mean, "deviation": self.deviation}
        numbers |= {f"weights{row}": part for row, part in enumerate(self.weights)}
        numbers |= {f"biases{row}": part for row, part in enumerate(self.biases)}
        arrays: dict[str, Any] = {name: array.astype(np.float32) for name, array in numbers.items()}
        stream = BytesIO()
        np.savez_compressed(stream, features=np.array(FEATURES), kinds=np.array(KINDS), **arrays)
        return stream.getvalue()

    @classmethod
    def read(cls, path: Path) -> Self:
        """The network of a file; raises ModelError if that cannot be read, has other features, or is not finite."""
        expected = f"{path}: expected weights that `lidcam train clusters` wrote"
        try:
            with np.load(BytesIO(read_small_file(path, MAX_BYTES)), allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except OSError as err:
            raise ModelError(f"{expected}, found that it cannot be read: {err.strerror or one_line(err)}") from err
        except (ValueError, zipfile.BadZipFile, EOFError, KeyError, AttributeError) as err:
            raise ModelError(f"{expected}, found {one_line(err)}") from err
        names = tuple(map(str, arrays.pop("features", ())))
        if names != FEATURES or tuple(map(str, arrays.pop("kinds", ()))) != KINDS:
            raise ModelError(f"{expected} in this version, found other features or classes: train it anew")
        layers = range(sum(name.startswith("weights") for name in arrays))
        try:
            numbers = {name: array.astype(np.float64) for name, array in arrays.items()}
            weights, biases = (tuple(numbers[f"{kind}{row}"] for row in layers) for kind in ("weights", "biases"))
            network = cls(numbers["mean"], numbers["deviation"], weights, biases)
            shape = network(np.zeros((1, len(FEATURES)))).shape
        except (KeyError, ValueError) as err:
            raise ModelError(f"{expected}, found arrays that do not fit each other: {one_line(err)}") from err
        if not all(np.isfinite(array).all() for array in numbers.values()):
            raise ModelError(f"{expected}, found numbers that are not finite: train it anew")
        if not layers or shape != (1, len(KINDS)):
            raise ModelError(f"{expected}, found arrays of other shapes")
        return network
