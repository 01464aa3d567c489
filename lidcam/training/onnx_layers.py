"""Layers of PyTorch as nodes of an ONNX file. Normalisation is folded into the layer before it."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from torch.nn.utils import fuse_conv_bn_eval

from lidcam.training.onnx_graph import Graph
from pipeline.core.arrays import Array

__all__ = ["convolution", "convolutions", "parameters"]


def convolutions(graph: Graph, image: str, layers: Iterable[Any]) -> str:
    """Convolutions, each with its normalisation and a ReLU behind it."""
    parts = [*layers]
    for layer, norm in zip(parts[::3], parts[1::3], strict=True):
        image = graph.add("Relu", convolution(graph, image, fuse_conv_bn_eval(layer, norm)))
    return image


def convolution(graph: Graph, image: str, layer: Any, name: str = "") -> str:
    """One convolution; the name of its output is one of its own if none is given."""
    strides, pads = [*layer.stride], [*layer.padding] * 2
    return graph.add("Conv", image, *parameters(layer), name=name, strides=strides, pads=pads)


def parameters(layer: Any) -> list[Array]:
    """The weights of a layer, and what it adds, if anything."""
    return [np.asarray(one.detach().numpy()) for one in (layer.weight, layer.bias) if one is not None]
