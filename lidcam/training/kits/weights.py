"""The weights of a checkpoint, as the layers of a network take them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.errors import ModelError

SHOWN = 4
UNUSED = ("num_batches_tracked", "global_step")
"""Counters that a training keeps."""


class Weights:
    """Gives each layer its weights, and keeps track of weights that fitted no layer."""

    def __init__(self, path: Path, weights: Mapping[str, F64]) -> None:
        self._path = path
        self._left = {name: array for name, array in weights.items() if name.rpartition(".")[2] not in UNUSED}
        self._missing: list[str] = []
        self._other: list[str] = []

    def __call__(self, name: str, *shape: int) -> F64:
        """The weights of that name; zero if they are missing or have another shape, which `check` reports."""
        found = self._left.pop(name, None)
        if found is not None and found.shape == shape:
            return found
        if found is None:
            self._missing.append(name)
        else:
            self._other.append(f"{name} {found.shape} in place of {shape}")
        return np.zeros([1] * len(shape))

    def folded(
        self, pair: tuple[str, str], shape: tuple[int, ...], eps: float, *, axis: int = 0, has_bias: bool = False
    ) -> tuple[F64, F64]:
        """Weights and bias of a layer with its normalisation folded in.

        Args:
            pair: Names of the layer and of the normalisation.
            shape: Shape of the layer's weights.
            eps: Epsilon of the normalisation.
            axis: Axis of the layer's outputs.
            has_bias: Whether the layer has a bias.
        """
        layer, norm = pair
        count = shape[axis]
        weight = self(f"{layer}.weight", *shape)
        bias = self(f"{layer}.bias", count) if has_bias else np.zeros(count)
        gain, shift, mean, variance = (
            self(f"{norm}.{part}", count) for part in ("weight", "bias", "running_mean", "running_var")
        )
        scale = gain / np.sqrt(variance + eps)
        along = [-1 if one == axis else 1 for one in range(len(shape))]
        return weight * scale.reshape(along), shift + (bias - mean) * scale

    def check(self) -> None:
        """Check that every layer had its weights, and that none are left.

        Raises:
            ModelError: not so; it names the layers.
        """
        faults = ("missing", self._missing), ("of another shape", self._other), ("not of this network", [*self._left])
        told = [f"{len(names)} {fault}: {_some(names)}" for fault, names in faults if names]
        if told:
            raise ModelError(f"{self._path}: expected the layers of its configuration, found {'; '.join(told)}")


def _some(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more
