"""Layers of PyTorch as nodes of an ONNX file.

Normalisation stays a separate node, so that a training can continue from the file; onnxruntime folds it into the
convolution before it.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from lidcam.pipeline.core.arrays import Array
from lidcam.training.onnx_graph import Graph


def convolutions(graph: Graph, image: str, layers: Iterable[Any]) -> str:
    """Convolutions, each followed by its normalisation and a ReLU."""
    parts = [*layers]
    for layer, norm in zip(parts[::3], parts[1::3], strict=True):
        image = graph.add("Relu", normalised(graph, convolution(graph, image, layer), norm))
    return image


def convolution(graph: Graph, image: str, layer: Any, name: str = "") -> str:
    """One convolution; without a name, its output gets a new one."""
    strides, pads = [*layer.stride], [*layer.padding] * 2
    return graph.add("Conv", image, *parameters(layer), name=name, strides=strides, pads=pads)


def normalised(graph: Graph, values: str, norm: Any) -> str:
    """A normalisation with the learned mean and variance."""
    return graph.add("BatchNormalization", values, *parameters(norm))


def parameters(layer: Any) -> list[Array]:
    """The numbers of a layer in the order of its node's inputs."""
    return [np.asarray(one.detach().numpy()) for one in tensors(layer)]


def tensors(layer: Any) -> list[Any]:
    """The same as PyTorch tensors: weights, bias if there is one, and for a normalisation mean and variance."""
    names = ("weight", "bias", "running_mean", "running_var")
    return [one for name in names if (one := getattr(layer, name, None)) is not None]
